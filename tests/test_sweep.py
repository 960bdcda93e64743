"""Sweeps: the runs of `manip train`, failures, interruptions, results."""

import csv
import os
import signal
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from threading import Event

import pytest
from training_runs import assert_equal_runs, contents, shared_scene, tiny

from manip.cluster.executors import run_jobs
from manip.cluster.job import Job, Outcome, Report, finished_result
from manip.cluster.jobs_display import duration
from manip.cluster.ledger import Ledger
from manip.cluster.local_executor import LocalExecutor
from manip.cluster.run_job import run_job
from manip.cluster.sweep_results import ScoredRun, read_results
from manip.cluster.sweep_summary import Summary
from manip.envs.backends import native_batch as native
from manip.errors import UserError
from manip.programs import aggregate, cli, sweep, train
from manip.studies.sweep_figure import draw_summary
from manip.training.final_evaluation import EvaluationOptions

TINY = """
    --task Reach --num-envs 4 --horizon 20 --steps 256 --threads 1
    --eval-every 128 --eval-episodes 2 --agent.actor-hidden 16
    --agent.critic-hidden 16
"""
GRID = f"{TINY} --algo ppo a2c --agent.rollout-length 16"

Row = dict[str, str]


def run_sweep(out: Path, options: str, processes: int = 1) -> int:
    own = f"--episodes 0 --processes {processes} --out {out}"
    return cli.run(sweep.main, f"{options} {own}".split())


def rows_of(out: Path, table: str = "results.csv") -> list[Row]:
    with (out / table).open(newline="") as file:
        return list(csv.DictReader(file))


def job(out: Path, name: str = "run", **changes: object) -> Job:
    return Job(name, tiny("ppo", out / name, **({"steps": 256} | changes)))


@pytest.fixture(scope="module", autouse=True)
def _scenes_are_built_once() -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(native, "load_scene", shared_scene)
        yield


@pytest.fixture(scope="module")
def swept(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a sweep that has finished; tests read it and do not change it."""
    out = tmp_path_factory.mktemp("sweeps") / "a"
    assert run_sweep(out, GRID) == 0
    return out


def test_a_cell_is_the_run_that_train_makes(swept: Path, tmp_path: Path) -> None:
    alone = tmp_path / "alone"
    options = GRID.replace("ppo a2c", "a2c")
    assert cli.run(train.main, [*options.split(), "--out", str(alone)]) == 0
    assert_equal_runs(swept / "runs" / "Reach-a2c-0", alone)


def test_results_have_a_row_per_run(swept: Path) -> None:
    rows = rows_of(swept)
    assert [row["run"] for row in rows] == ["Reach-ppo-0", "Reach-a2c-0"]
    assert {row["status"] for row in rows} == {"finished"}
    assert {row["evaluated"] for row in rows} == {"training"}
    assert {row["env_steps"] for row in rows} == {"256"}
    aggregates = rows_of(swept, "aggregates.csv")
    assert [(row["variant"], row["runs"]) for row in aggregates] == [
        ("ppo", "1"),
        ("a2c", "1"),
    ]
    assert (swept / "aggregates.png").stat().st_size > 1000
    assert "checkpoint:" in (swept / "logs" / "Reach-a2c-0.log").read_text()


def test_a_finished_sweep_repeats_nothing(swept: Path) -> None:
    before = contents(swept / "runs")
    assert run_sweep(swept, GRID) == 0
    assert contents(swept / "runs") == before


def test_a_sweep_is_enlarged_and_its_file_is_a_grid(swept: Path) -> None:
    before = contents(swept / "runs" / "Reach-ppo-0")
    assert run_sweep(swept, f"--grid {swept / 'sweep.yaml'} --seed 0:2") == 0
    assert [row["seed"] for row in rows_of(swept)] == ["0", "1", "0", "1"]
    assert contents(swept / "runs" / "Reach-ppo-0") == before


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ("--steps many", "manip train --steps many: Error parsing --steps"),
        ("--agent.gama 1", "Unrecognized options: --agent.gama"),
        ("--agent.gamma 0.9 1.5", "gamma must be from 0 to 1, not 1.5"),
        ("--algo sac ppo --agent.tau 0.1", "algo ppo .*Unrecognized options"),
        ("--task Reach Lfit", "unknown task 'Lfit'"),
        ("--robot Panda Pando", "unknown robot 'Pando'"),
        ("--seed 1 1", "the grid holds a run twice: Lift-sac-1 and Lift-sac-1"),
        ("--agent.gamma 0.9 0.90", "twice: Lift-sac-gamma=0.9-0 and"),
        ("--processes 0", "--processes must be at least 1, not 0"),
        ("--episodes -1", "--episodes must be at least 0, not -1"),
        ("--grid nowhere.yaml", "there is no file nowhere.yaml"),
        ("--threads 2 --seed x", "--seed takes numbers or ranges"),
    ],
)
def test_mistakes_are_refused_before_the_first_run(
    options: str, message: str, tmp_path: Path
) -> None:
    arguments = f"{options} --out {tmp_path / 'new'}".split()
    with pytest.raises(UserError, match=message):
        sweep.main(arguments)
    assert list(tmp_path.iterdir()) == []


def test_folders_of_others_are_refused(swept: Path, tmp_path: Path) -> None:
    message = "holds another sweep .*sweep.yaml lists its options"
    with pytest.raises(UserError, match=message):
        sweep.main(f"{TINY} --out {swept}".split())
    (tmp_path / "thesis.tex").touch()
    with pytest.raises(UserError, match=r"is not empty.*\(it holds thesis.tex\)"):
        sweep.main(f"{TINY} --out {tmp_path}".split())


def test_a_failed_run_is_named_and_stops_no_other(tmp_path: Path, capsys) -> None:
    """Four environments do not split over three workers."""
    grid = f"{TINY} --algo a3c --agent.rollout-length 8 --agent.workers 3 2"
    assert run_sweep(tmp_path / "a", grid) == 1
    printed = capsys.readouterr()
    name = "Reach-a3c-workers=3-0"
    assert f"[1/2] {name} failed: num_envs 4 does not split" in printed.err
    assert f"{name} failed: num_envs 4 does not split" in printed.out
    rows = rows_of(tmp_path / "a")
    assert [row["status"] for row in rows] == ["failed", "finished"]
    assert "does not split" in rows[0]["error"]


class StopAtFirst(Ledger):
    """Ends a sweep at the first report."""

    def __init__(self, jobs: Sequence[Job], stop: Event) -> None:
        super().__init__(jobs)
        self._stop = stop

    def reported(self, job: Job, report: Report) -> None:
        super().reported(job, report)
        self._stop.set()


@pytest.mark.parametrize("processes", [1, pytest.param(2, marks=pytest.mark.slow)])
def test_a_stopped_job_continues_where_it_was(processes: int, tmp_path: Path) -> None:
    names = "ab"[:processes] + "c"
    jobs = [job(tmp_path / "a", name, seed=i) for i, name in enumerate(names)]
    watch = StopAtFirst(jobs, stop := Event())
    LocalExecutor(processes)(jobs, watch, stop)
    states = [entry.state for entry in watch.entries.values()]
    assert states == ["stopped"] * processes + ["waiting"]
    outcomes = run_jobs(jobs, LocalExecutor(processes))
    assert {outcome.status for outcome in outcomes.values()} == {"finished"}
    for one in jobs:
        other = replace(one.config, out=tmp_path / "b" / one.name)
        assert run_job(Job("other", other), lambda _: None, Event()).result
        assert_equal_runs(one.config.folder, other.folder)


def test_a_job_is_evaluated_and_only_once(tmp_path: Path) -> None:
    evaluation = EvaluationOptions("native", 3, processes=1)
    one = replace(job(tmp_path), evaluation=evaluation)
    reports: list[Report] = []
    outcome = run_job(one, reports.append, Event())
    assert outcome.result
    assert outcome.result.evaluation["episodes"] == 3 == reports[-1].episodes
    assert finished_result(one) == outcome.result
    before = contents(tmp_path)
    assert run_job(one, reports.append, Event()) == outcome
    assert contents(tmp_path) == before
    more = replace(one, evaluation=replace(evaluation, episodes=4))
    assert finished_result(more) is None
    assert run_job(more, reports.append, Event()).result
    assert before.items() - contents(tmp_path).items()


def test_a_damaged_result_is_named(tmp_path: Path) -> None:
    one = job(tmp_path)
    one.config.folder.mkdir(parents=True)
    (one.config.folder / "result.json").write_text('{"env_steps": "many"}')
    with pytest.raises(UserError, match=r"result.json is damaged: .*; remove it"):
        finished_result(one)


class KillFirst(Ledger):
    """Kills the process of the first job that reports."""

    executor: LocalExecutor
    victim: str = ""

    def reported(self, job: Job, report: Report) -> None:
        super().reported(job, report)
        if not self.victim:
            self.victim = job.name
            busy = [
                w for w in self.executor._workers if w.job and w.job.name == job.name
            ]
            os.kill(busy[0].process.pid or 0, signal.SIGKILL)


@pytest.mark.slow
def test_a_process_that_dies_fails_its_run_only(tmp_path: Path) -> None:
    jobs = [job(tmp_path, name) for name in "abc"]
    watch = KillFirst(jobs)
    watch.executor = LocalExecutor(2, tmp_path / "logs")
    watch.executor(jobs, watch, Event())
    lost = watch.outcomes.pop(watch.victim)
    assert lost.status == "failed"
    assert "ended by signal 9: is there too little memory?" in lost.error
    states = {name: entry.state for name, entry in watch.entries.items()}
    assert sorted(states.values()) == ["failed", "finished", "finished"]
    outcomes = run_jobs(jobs, LocalExecutor(1))
    assert {outcome.status for outcome in outcomes.values()} == {"finished"}


def test_the_time_left_is_that_of_the_steps_left(monkeypatch) -> None:
    jobs = [job(Path(name), name, steps=1000) for name in "abcd"]
    ledger, now = Ledger(jobs), [100.0]
    monkeypatch.setattr("time.monotonic", lambda: now[0])
    assert ledger.seconds_left() is None
    for one in jobs[:2]:
        ledger.started(one)
        ledger.reported(one, Report(env_steps=500))  # resumed there
    now[0] += 10
    for one in jobs[:2]:
        ledger.reported(one, Report(env_steps=600))
    assert ledger.seconds_left() == pytest.approx(0.1 * (2 * 400 + 2 * 1000) / 2)
    ledger.ended(jobs[0], Outcome("failed", error="x"))
    assert ledger.seconds_left() == pytest.approx(0.1 * (400 + 2 * 1000))


def test_durations_are_short() -> None:
    assert [duration(s) for s in (5, 600, 9000)] == ["5 s", "10 min", "2.5 h"]


def scored(task: str, seed: int, rate: float, **options: str) -> ScoredRun:
    return ScoredRun(task, seed, options, {"success_held": rate})


RUNS = [
    scored(task, seed, rate + shift + 0.01 * seed, algo=algo, steps="10")
    for task, shift in (("Lift", 0.0), ("Reach", 0.2))
    for algo, rate in (("sac", 0.6), ("td3", 0.3))
    for seed in range(4)
]


def test_variants_are_aggregated_over_seeds_and_tasks(tmp_path: Path) -> None:
    summary = Summary(RUNS, "success_held")
    rows = {(a.variant, a.task): a for a in summary.aggregates}
    assert [*rows] == [
        (algo, task)
        for algo in ("sac", "td3")
        for task in ("Lift", "Reach", "all tasks")
    ]
    total = rows["td3", "all tasks"]
    assert (total.runs, total.mean.value) == (8, pytest.approx(0.415))
    assert total.mean.low < total.mean.value < total.mean.high
    assert summary.best == "sac"
    (worse,) = summary.improvements_over_best()
    assert (worse.variant, worse.probability.value) == ("td3", 0)
    draw_summary(summary, tmp_path / "figure.png")
    assert (tmp_path / "figure.png").stat().st_size > 10_000


def test_results_of_several_sweeps_add_up(swept: Path, tmp_path: Path, capsys) -> None:
    other = tmp_path / "b"
    seeds = GRID.replace("ppo a2c", "ppo") + " --seed 5"
    assert run_sweep(other, seeds) == 0
    runs = read_results([swept, other])
    assert {run.seed for run in runs if run.options["algo"] == "ppo"} >= {0, 5}
    command = f"{swept} {other} --out {tmp_path / 'both'}"
    assert cli.run(aggregate.main, command.split()) == 0
    assert "success_held" in capsys.readouterr().out
    with pytest.raises(UserError, match="two folders hold the same run"):
        read_results([other, other])


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ("", "needs the folder of a sweep"),
        ("a b", "--out is needed to compare several sweeps"),
        ("nowhere", "there is no nowhere/results.csv"),
    ],
)
def test_aggregate_names_mistakes(arguments: str, message: str) -> None:
    with pytest.raises(UserError, match=message):
        aggregate.main(arguments.split())


def test_damaged_results_are_named(swept: Path, tmp_path: Path) -> None:
    text = (swept / "results.csv").read_text()
    for damaged in (text.replace("finished,256", "finished,256,3"), "a,b\n1,2\n"):
        (tmp_path / "results.csv").write_text(damaged)
        with pytest.raises(UserError, match=r"results.csv is damaged"):
            read_results([tmp_path])
