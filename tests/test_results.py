"""What the shipped recipes reach: stored, shown, and reproduced."""

import json
from dataclasses import replace
from pathlib import Path

import pytest

from manip.agents import policy
from manip.agents.policy import load_policy, shipped_policies
from manip.envs.backends.native_batch import NativeBatch
from manip.envs.task_registry import load_task
from manip.errors import UserError
from manip.evaluation import runners as evaluation
from manip.evaluation.shipped_results import Results, Run, load_results, markdown
from manip.programs import cli, reproduce
from manip.programs.results import with_table
from manip.robot_config import ROBOTS
from manip.training.config import recipe_names, recipes
from manip.training.run import train_or_resume

README = (Path(__file__).parents[1] / "README.md").read_text()


def test_the_readme_shows_the_stored_results() -> None:
    assert with_table(README, markdown(load_results())) == README
    with pytest.raises(UserError, match="no place for results"):
        with_table("no marks", "")


def test_every_result_is_of_a_recipe_and_an_arm() -> None:
    known = {(config.task, config.algo) for config in recipes().values()}
    stored = load_results()
    assert len({result.key for result in stored.results}) == len(stored.results) > 2
    for result in stored.results:
        assert (result.task, result.algo) in known
        assert result.robot in ROBOTS
        for run in result.runs:
            assert 0 <= run.success_held <= run.episodes
            assert 0 < run.rate.low <= run.rate.rate <= run.rate.high <= 1


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("name", shipped_policies())
def test_a_shipped_policy_loads_and_has_a_result(name: str) -> None:
    card = load_policy(name).card
    assert card.name == name
    run = load_results().run((card.task, card.robot, card.algo), card.seed)
    assert run
    assert run.env_steps >= card.env_steps
    assert run.rate.rate >= reproduce.WORTH


@pytest.mark.slow
@pytest.mark.parametrize("name", shipped_policies())
def test_a_shipped_policy_fits_its_task(name: str) -> None:
    card = load_policy(name).card
    rig = card.robot_config
    worlds = NativeBatch(load_task(card.task), 1, robot=rig, threads=1)
    assert worlds.action_dim == card.action_dim
    found = {name: [part.start, part.stop] for name, part in worlds.layout.items()}
    assert found == card.layout


def test_results_survive_their_file(tmp_path: Path) -> None:
    stored = load_results()
    stored.save(tmp_path / "results.yaml")
    assert load_results(tmp_path / "results.yaml") == stored
    (tmp_path / "results.yaml").write_text("results: 3")
    with pytest.raises(UserError, match=r"results.yaml is damaged"):
        load_results(tmp_path / "results.yaml")


@pytest.mark.parametrize(
    ("held", "before", "found"),
    [
        (97, 99, "agrees"),
        (80, 99, "worse"),
        (99, 80, "better"),
        (97, None, "new"),
    ],
)
def test_runs_compare_by_their_intervals(held, before, found) -> None:
    run = Run(0, held, 100, 80_000, 2.0)
    stored = None if before is None else replace(run, success_held=before)
    assert reproduce.verdict(run, stored) == found


def asked(*what: str, robot: str | None = None) -> list[tuple[str, str, str]]:
    options, stored = reproduce.Reproduce(what, robot), load_results()
    jaco = replace(stored.results[0], task="Lift", algo="sac", robot="Jaco")
    found = reproduce.chosen(options, replace(stored, results=(jaco,)))
    return [reproduce._key(config) for config in found]


def test_recipes_are_found_by_name_task_and_arm() -> None:
    assert asked("lift-sac") == [("Lift", "Panda", "sac"), ("Lift", "Jaco", "sac")]
    assert asked("lift-sac", robot="IIWA") == [("Lift", "IIWA", "sac")]
    algos = {name.split("-", 1)[1] for name in recipe_names() if "lift-" in name}
    pandas = {("Lift", "Panda", algo) for algo in algos}
    assert {*asked("Lift")} == {*pandas, ("Lift", "Jaco", "sac")}
    assert len(asked("all", robot="Panda")) == len(recipe_names())
    with pytest.raises(UserError, match="unknown recipe 'Lfit': did you mean 'Lift'"):
        asked("Lfit")
    with pytest.raises(UserError, match="reproduce what"):
        asked()


@pytest.fixture
def tiny(monkeypatch, tmp_path: Path) -> Path:
    """One tiny recipe, and where its results are stored."""
    config = recipes()["reach-ppo"]
    agent = replace(
        config.agent, rollout_length=8, actor_hidden=(8,), critic_hidden=(8,)
    )
    config = replace(
        config, steps=64, num_envs=4, eval_every=64, eval_episodes=1, agent=agent
    )
    results = tmp_path / "results.yaml"
    Results({}, ()).save(results)
    monkeypatch.setattr(reproduce, "recipes", lambda robot=None: {"reach-ppo": config})
    monkeypatch.setattr(reproduce, "load_results", lambda: load_results(results))
    monkeypatch.setattr(reproduce, "RESULTS", results)
    for module in (policy, reproduce):
        monkeypatch.setattr(module, "SHIPPED", tmp_path / "policies")
    monkeypatch.setattr(evaluation, "usable_cpus", lambda: 1)
    return results


def test_a_recipe_is_reproduced_and_compared(tiny: Path, tmp_path: Path) -> None:
    found = tmp_path / "found.json"
    command = ["Reach", "--seeds", "1", "--episodes", "1", "--out", str(tmp_path)]
    assert cli.run(reproduce.main, [*command, "--write"]) == 0
    (result,) = load_results(tiny).results
    (run,) = result.runs
    assert (result.key, run.seed) == (("Reach", "Panda", "ppo"), 0)
    assert (run.success_held, run.episodes, run.env_steps) == (0, 1, 64)
    assert shipped_policies() == {}  # it did not hold
    good = replace(result, runs=(replace(run, success_held=1),))
    reproduce._ship_policy(good, tmp_path, load_results(tiny))
    assert load_policy("Reach").card.env_steps == 64
    better = replace(result, runs=(replace(run, success_held=100, episodes=100),))
    Results({}, (better,)).save(tiny)
    assert cli.run(reproduce.main, [*command, "--json", str(found)]) == 1
    (row,) = json.loads(found.read_text())["results"]
    assert row["runs"][0]["verdict"] == "worse"
    assert row["runs"][0]["shipped"]["rate"] == 1.0
    assert (row["runs"][0]["success_held"], row["runs"][0]["env_steps"]) == (0, 64)
    assert load_results(tiny).results == (better,)


def test_a_run_with_other_options_is_not_taken_up(tiny: Path, tmp_path: Path) -> None:
    (config,) = reproduce.recipes().values()
    folder = tmp_path / "run"
    train_or_resume(replace(config, out=folder))
    with pytest.raises(UserError, match="cannot go on with other options"):
        train_or_resume(replace(config, out=folder, seed=1))
