"""Sweeps and collectors on a Ray cluster: two nodes here, one of which is killed."""

import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from threading import Event
from typing import Any

import pytest
from training_runs import assert_equal_runs, tiny

from manip.cluster import ray_executor
from manip.cluster.job import Job, Report
from manip.cluster.ledger import Ledger
from manip.cluster.ray_collectors import ray_collectors
from manip.cluster.ray_executor import RayExecutor
from manip.cluster.ray_head import Head, Setup
from manip.cluster.run_job import run_job
from manip.errors import UserError
from manip.programs import cli, sweep
from manip.programs import train as train_program
from manip.training.progress import Progress
from manip.training.run import train
from manip.versions import versions


def test_without_ray_the_option_says_how_to_install_it(tmp_path, monkeypatch) -> None:
    monkeypatch.setitem(sys.modules, "ray", None)
    arguments = f"--task Reach --ray auto --out {tmp_path / 'a'}".split()
    with pytest.raises(UserError, match="--ray needs the package ray: pip install ray"):
        sweep.main(arguments)
    assert list(tmp_path.iterdir()) == []


def test_training_says_how_to_install_ray(tmp_path, monkeypatch, capsys) -> None:
    monkeypatch.setitem(sys.modules, "ray", None)
    arguments = f"--task Reach --collectors 2 --ray auto --out {tmp_path / 'a'}"
    assert cli.run(train_program.main, arguments.split()) == 2
    assert "pip install ray" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


def test_processes_and_ray_exclude_each_other(tmp_path: Path) -> None:
    arguments = f"--ray auto --processes 2 --out {tmp_path / 'a'}".split()
    with pytest.raises(UserError, match="--processes has no effect with --ray"):
        sweep.main(arguments)


def test_the_head_begins_no_task_once_it_stops(tmp_path: Path) -> None:
    head = Head({"a": tmp_path, "b": tmp_path})
    assert head.begin("a")
    assert not head.report("a", Report(5))
    assert head.take() == [("a", None), ("a", Report(5))]
    assert head.stop() == {"a"}
    assert head.report("a", Report(6))
    assert not head.begin("b")
    assert head.take() == [("a", Report(6))]


def test_the_head_holds_run_folders(tmp_path: Path) -> None:
    head = Head({"a": tmp_path})
    head.store("a", "checkpoints/latest.safetensors", b"12")
    head.store("a", "metrics.csv", b"3")
    assert head.files("a") == {
        "checkpoints/latest.safetensors": b"12",
        "metrics.csv": b"3",
    }


STEPS = 8192
"""Long enough to be killed in between."""


class Nodes(Ledger):
    """Kills a node once both runs have reported."""

    def __init__(self, jobs: Sequence[Job], cluster: Any, victim: Any) -> None:
        super().__init__(jobs)
        self._cluster, self._victim = cluster, victim
        self.begun: list[str] = []

    def started(self, job: Job) -> None:
        super().started(job)
        self.begun.append(job.name)

    def reported(self, job: Job, report: Report) -> None:
        super().reported(job, report)
        steps = [entry.report.env_steps for entry in self.entries.values()]
        if self._victim and min(steps) > 0:
            self._cluster.remove_node(self._victim, allow_graceful=False)
            self._victim = None


@pytest.fixture
def cluster() -> Iterator[Any]:
    utils = pytest.importorskip("ray.cluster_utils")
    head = {"num_cpus": 1, "include_dashboard": False}
    cluster = utils.Cluster(initialize_head=True, head_node_args=head)
    yield cluster
    cluster.shutdown()


def here(directory: Path, token: Path, used: dict[str, str]) -> Setup:
    """As on a node that does not see the sweep's folder."""
    return Setup(Path("/nowhere"), Path(token.name), used)


@pytest.mark.slow
@pytest.mark.parametrize("shared", [True, False])
def test_runs_of_a_node_that_dies_continue_on_another(
    shared: bool, cluster: Any, tmp_path: Path, monkeypatch
) -> None:
    if not shared:
        monkeypatch.setattr(ray_executor, "Setup", here)
    victim = cluster.add_node(num_cpus=1)
    options = {"steps": STEPS, "threads": 1}
    jobs = [
        Job(n, tiny("ppo", tmp_path / n, seed=i, **options)) for i, n in enumerate("ab")
    ]
    watch = Nodes(jobs, cluster, victim)
    RayExecutor(cluster.address, tmp_path, tmp_path / "logs")(jobs, watch, Event())
    assert {o.status for o in watch.outcomes.values()} == {"finished"}
    assert sorted(watch.begun) in (["a", "a", "b"], ["a", "b", "b"])
    assert "checkpoint:" in (tmp_path / "logs" / "a.log").read_text()
    for job in jobs:
        folder = tmp_path / "alone" / job.name
        alone = tiny("ppo", folder, seed=job.config.seed, **options)
        assert run_job(Job(job.name, alone), lambda _: None, Event()).result
        assert_equal_runs(job.config.folder, folder)


@pytest.mark.slow
def test_tasks_stop_and_continue(cluster: Any, tmp_path: Path) -> None:
    """One CPU: the second run waits, and is never begun."""
    jobs = [Job(n, tiny("ppo", tmp_path / n, steps=STEPS, threads=1)) for n in "ab"]
    watch = StopAtFirst(jobs)
    RayExecutor(cluster.address, tmp_path)(jobs, watch, watch.stop)
    states = [entry.state for entry in watch.entries.values()]
    assert sorted(states) == ["stopped", "waiting"]
    assert not list(tmp_path.glob(".token*"))


class StopAtFirst(Ledger):
    """Stops at the first report."""

    def __init__(self, jobs: Sequence[Job]) -> None:
        super().__init__(jobs)
        self.stop = Event()

    def reported(self, job: Job, report: Report) -> None:
        super().reported(job, report)
        self.stop.set()


@pytest.mark.slow
def test_nodes_with_other_versions_are_refused(cluster: Any, tmp_path, monkeypatch):
    other = versions() | {"torch": "1.0"}
    monkeypatch.setattr(ray_executor, "versions", lambda: other)
    job = Job("a", tiny("ppo", tmp_path / "a", threads=1))
    watch = Ledger([job])
    RayExecutor(cluster.address, tmp_path)([job], watch, Event())
    assert "not 1.0: install the same" in watch.outcomes["a"].error


@pytest.mark.slow
def test_an_address_without_a_cluster_is_named(tmp_path: Path) -> None:
    pytest.importorskip("ray")
    with pytest.raises(UserError, match="there is no Ray cluster at auto"):
        RayExecutor("auto", tmp_path)


@pytest.mark.slow
@pytest.mark.parametrize("algo", ["ppo", "a2c", "sac", "a3c"])
def test_a_run_does_not_depend_on_ray(algo: str, cluster: Any, tmp_path: Path) -> None:
    cluster.add_node(num_cpus=1)
    groups = {} if algo == "a3c" else {"collectors": 2}
    assert train(tiny(algo, tmp_path / "here", **groups)).finished
    with ray_collectors(cluster.address) as place:
        assert train(tiny(algo, tmp_path / "ray", **groups), place=place).finished
    assert_equal_runs(tmp_path / "here", tmp_path / "ray")


@pytest.mark.slow
@pytest.mark.parametrize("algo", ["ppo", "sac"])
def test_a_collector_that_dies_is_replaced(
    algo: str, cluster: Any, tmp_path: Path, capfd
) -> None:
    """One of three, with its node; another node takes its place."""
    nodes, messages = [cluster.add_node(num_cpus=1) for _ in range(2)], []
    options = {"collectors": 3, "num_envs": 6, "steps": 768}
    assert train(tiny(algo, tmp_path / "here", **options)).finished

    def kill(progress: Progress) -> None:
        messages.extend(progress.messages)
        if progress.env_steps > 300 and len(nodes) == 2:
            cluster.add_node(num_cpus=1)
            cluster.remove_node(nodes.pop(), allow_graceful=False)

    config = tiny(algo, tmp_path / "ray", **options)
    with ray_collectors(cluster.address) as place:
        assert train(config, place=place, callback=kill).finished
    assert_equal_runs(tmp_path / "here", tmp_path / "ray")
    (message,) = [line for line in messages if "was lost" in line]
    assert "is replaced" in message
    assert "\n" not in message
    assert "worker" not in "".join(capfd.readouterr())  # Ray's own paragraphs


@pytest.mark.slow
def test_more_collectors_than_cpus_are_refused(cluster: Any, tmp_path: Path) -> None:
    config = tiny("ppo", tmp_path / "run", collectors=2)
    with (
        ray_collectors(cluster.address) as place,
        pytest.raises(UserError, match=r"2 collectors take a CPU each, but .* has 1"),
    ):
        train(config, place=place)
