"""Results of the shipped recipes: stored, shown, and reproduced."""

import json
from dataclasses import replace
from pathlib import Path

import pytest

from manip.agents import policy as policy_files
from manip.agents.policy import SHIPPED, Policy, load_policy, shipped_policies
from manip.envs.episode_streams import CHOICE, EVALUATION
from manip.errors import UserError
from manip.evaluation.comparison import comparison_record, verdict
from manip.evaluation.episodes import Episode
from manip.evaluation.results_table import HEADER, markdown, rows
from manip.evaluation.runners import EpisodeSettings, make_env
from manip.evaluation.shipped_results import Result, Results, Run, load_results
from manip.programs import cli, reproduce
from manip.programs import ship_policy as shipping
from manip.programs.results import with_table
from manip.robot_config import ROBOTS
from manip.training import final_evaluation
from manip.training.recipes import recipe_names, recipes
from manip.training.run import train_or_resume

README = (Path(__file__).parents[1] / "README.md").read_text()


def test_the_readme_shows_the_stored_results() -> None:
    assert with_table(README, markdown(load_results())) == README
    with pytest.raises(UserError, match="no place for the table"):
        with_table("no marks", "")


def test_every_result_is_of_a_recipe_and_an_arm() -> None:
    known = {(config.task, config.method) for config in recipes().values()}
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
    run = load_results().run((card.task, card.robot, card.method), card.seed)
    assert run
    assert run.env_steps >= card.env_steps
    assert run.rate.rate >= shipping.WORTH


@pytest.mark.slow
@pytest.mark.parametrize("name", shipped_policies())
def test_a_shipped_policy_fits_its_task(name: str) -> None:
    card = load_policy(name).card
    needed = card.observation
    settings = EpisodeSettings(
        card.task, card.robot_config, needed, card.cameras, backend="native"
    )
    env = make_env(settings)
    assert env.batch.action_dim == card.action_dim


def test_results_survive_their_file(tmp_path: Path) -> None:
    stored = load_results()
    stored.save(tmp_path / "results.yaml")
    assert load_results(tmp_path / "results.yaml") == stored
    (tmp_path / "results.yaml").write_text("results: 3")
    with pytest.raises(UserError, match=r"results.yaml is damaged"):
        load_results(tmp_path / "results.yaml")


def result_of(*held: int, choice: tuple[float, ...] = ()) -> Result:
    """A result of Reach whose seeds 0, 1, ... held so many of 100 episodes."""
    rates = choice or (None,) * len(held)
    runs = tuple(
        Run(seed, count, 100, 64, 2.0, rate)
        for seed, (count, rate) in enumerate(zip(held, rates, strict=True))
    )
    return Result("Reach", "Panda", "ppo", False, "a machine", runs)


@pytest.mark.parametrize(
    ("held", "before", "expected"),
    [
        ((97, 96, 98), (99, 95, 97), "agrees"),
        ((100, 89, 95), (100, 96, 95, 98, 89), "agrees"),
        ((60, 65, 58), (99, 95, 97), "worse"),
        ((99, 95, 97), (60, 65, 58), "better"),
        ((0,), (100,), "cannot tell"),
        ((97, 96, 98), (), "new"),
    ],
)
def test_recipes_are_compared_over_their_seeds(held, before, expected) -> None:
    stored = Results({}, (result_of(*before),) if before else ())
    assert verdict(result_of(*held), stored) == expected


def test_a_row_says_how_many_seeds_its_interval_covers() -> None:
    several, single = result_of(90, 100, 95), result_of(95)
    first, second = rows(Results({}, ()), [several, single])
    seeds, rate = HEADER.index("seeds"), HEADER.index("success_held [%]")
    assert (first[seeds], second[seeds]) == ("3", "1")
    assert first[rate].startswith("95 (")
    assert second[rate] == "95 (89-98)*"
    low, high = several.rate.low, several.rate.high
    assert high - low > single.rate.high - single.rate.low
    assert "one seed: over episodes only" in markdown(Results({}, (single,)))


def test_a_record_says_what_its_interval_covers() -> None:
    stored = Results({}, (result_of(97, 99, 100),))
    several = comparison_record(result_of(90, 100, 95), stored)
    assert (several["seeds"], several["shipped_seeds"]) == (3, 3)
    assert several["interval_covers"] == "seeds and episodes"
    single = comparison_record(result_of(95), Results({}, ()))
    assert single["interval_covers"] == "episodes only"
    assert (single["verdict"], single["shipped"]) == ("new", None)


def shipped_by(tmp_path: Path, result: Result, stored: Results) -> list[int]:
    """Seeds of the shipped policies after a result; before it, those of `stored` are.

    Each seed of the result has a policy of its own.
    """
    folders = {run.seed: tmp_path / str(run.seed) for run in result.runs}
    for seed, folder in folders.items():
        policy_of("ppo", seed).save(folder / "policy")
    with pytest.MonkeyPatch.context() as patch:
        for module in (policy_files, shipping):
            patch.setattr(module, "SHIPPED", tmp_path / "policies")
        for old in stored.results:
            policy_of(old.algo, old.runs[0].seed).save(tmp_path / "policies" / "Reach")
        shipping.ship_policy(result, folders, stored)
        return [load_policy(folder).card.seed for folder in shipped_policies().values()]


def policy_of(algo: str, seed: int) -> Policy:
    """The shipped policy of Reach, as if it were of another algorithm and seed."""
    policy = load_policy(SHIPPED / "Reach")
    return replace(policy, card=replace(policy.card, algo=algo, seed=seed))


def test_the_shipped_seed_is_chosen_in_other_episodes_than_the_results(tmp_path):
    """Seed 0 has the best result by chance; seed 1 is best where seeds are chosen."""
    result = result_of(100, 97, 98, choice=(0.93, 0.99, 0.95))
    assert shipped_by(tmp_path, result, Results({}, ())) == [1]


def test_a_policy_that_fails_where_seeds_are_chosen_is_not_shipped(tmp_path) -> None:
    assert shipped_by(tmp_path, result_of(95, choice=(0.89,)), Results({}, ())) == []


@pytest.mark.parametrize(("held", "shipped"), [(100, 0), (96, 7)])
def test_another_algorithms_policy_stays_if_none_is_surely_better(
    tmp_path, held: int, shipped: int
) -> None:
    """The intervals of 100 and 96 of 100 episodes begin at 96.3 and 90.2 %."""
    other = replace(result_of(93).runs[0], seed=7)
    stored = Results({}, (replace(result_of(93), algo="bc", runs=(other,)),))
    assert shipped_by(tmp_path, result_of(held), stored) == [shipped]


def keys(*what: str, robot: str | None = None) -> list[tuple[str, str, str]]:
    options, stored = reproduce.Reproduce(what, robot), load_results()
    jaco = replace(stored.results[0], task="Lift", algo="sac", robot="Jaco")
    configs = reproduce.chosen(options, replace(stored, results=(jaco,)))
    return [(config.task, config.robot, config.method) for config in configs]


def test_recipes_are_found_by_name_task_and_arm() -> None:
    assert keys("lift-sac") == [("Lift", "Panda", "sac"), ("Lift", "Jaco", "sac")]
    assert keys("lift-sac", robot="IIWA") == [("Lift", "IIWA", "sac")]
    algos = {name.split("-", 1)[1] for name in recipe_names() if "lift-" in name}
    pandas = {("Lift", "Panda", algo) for algo in algos}
    assert {*keys("Lift")} == {*pandas, ("Lift", "Jaco", "sac")}
    assert len(keys("all", robot="Panda")) == len(recipe_names())
    with pytest.raises(UserError, match="unknown recipe 'Lfit': did you mean 'Lift'"):
        keys("Lfit")
    with pytest.raises(UserError, match="no recipe is named"):
        keys()


@pytest.fixture
def tiny(monkeypatch, tmp_path: Path) -> Path:
    """One tiny recipe whose policies fail, and the file of its results."""
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
    for module in (policy_files, shipping):
        monkeypatch.setattr(module, "SHIPPED", tmp_path / "policies")
    failed = Episode(0, 9, 1.0, False, False, False, None, (False, False))
    for module in (reproduce, final_evaluation):
        monkeypatch.setattr(module, "evaluate_policy", lambda *_: [failed])
    return results


def test_a_recipe_is_reproduced_and_compared(tiny: Path, tmp_path: Path) -> None:
    record = tmp_path / "record.json"
    command = ["Reach", "--seeds", "1", "--episodes", "1", "--out", str(tmp_path)]
    command += ["--processes", "1"]
    assert cli.run(reproduce.main, [*command, "--write"]) == 0
    (result,) = load_results(tiny).results
    (run,) = result.runs
    assert (result.key, run.seed) == (("Reach", "Panda", "ppo"), 0)
    assert (run.success_held, run.episodes, run.env_steps) == (0, 1, 64)
    assert run.choice_rate == 0
    assert shipped_policies() == {}  # no episode was held
    better = replace(result, runs=(replace(run, success_held=100, episodes=100),) * 3)
    Results({}, (better,)).save(tiny)
    assert cli.run(reproduce.main, [*command, "--json", str(record)]) == 1
    (row,) = json.loads(record.read_text())["results"]
    assert (row["verdict"], row["seeds"], row["shipped_seeds"]) == ("worse", 1, 3)
    assert row["rate"].keys() == row["shipped"].keys() == {"rate", "low", "high"}
    assert (row["shipped"]["rate"], row["rate"]["rate"]) == (1.0, 0.0)
    assert (row["runs"][0]["success_held"], row["runs"][0]["env_steps"]) == (0, 64)
    assert load_results(tiny).results == (better,)


def test_results_are_of_other_episodes_than_the_choice(tiny, tmp_path, monkeypatch):
    used = []

    def record(policy, settings, *progress):
        used.append((settings.purpose, settings.backend))
        return [Episode(0, 9, 1.0, True, True, True, 3, (True, True))]

    for module in (reproduce, final_evaluation):
        monkeypatch.setattr(module, "evaluate_policy", record)
    command = ["Reach", "--seeds", "1", "--episodes", "1", "--out", str(tmp_path)]
    assert cli.run(reproduce.main, [*command, "--processes", "1"]) == 0
    assert used == [(EVALUATION, "stock"), (CHOICE, "native")]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("--json", "."), "--json . is a folder: name a file"),
        (("--out", "/dev/null"), "--out /dev/null is not a folder"),
        (("--seeds", "100000000"), "--seeds must be at most 1000"),
        (("--episodes", "100000000"), "--episodes must be at most 100000"),
    ],
)
def test_reproduce_refuses_before_it_trains(tiny, options, message, capsys) -> None:
    assert cli.run(reproduce.main, ["Reach", *options]) == 2
    assert capsys.readouterr().err.startswith(f"manip: error: {message}")


def test_a_run_with_other_options_is_not_taken_up(tiny: Path, tmp_path: Path) -> None:
    (config,) = reproduce.recipes().values()
    folder = tmp_path / "run"
    train_or_resume(replace(config, out=folder))
    with pytest.raises(UserError, match="cannot be resumed with other options"):
        train_or_resume(replace(config, out=folder, seed=1))
