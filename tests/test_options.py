"""Any options, from files or command lines, build an agent or raise one line."""

import math
from dataclasses import dataclass, fields, replace
from pathlib import Path
from types import UnionType
from typing import Annotated, Any, get_args, get_origin, get_type_hints

import pytest
import yaml
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

from manip.agents.agent import Spaces
from manip.agents.registry import algorithm_names, load_algorithm
from manip.agents.sac import SACConfig
from manip.errors import UserError
from manip.io.option_ranges import Range, check_options, ranges_of
from manip.programs import cli, evaluate, render, replay, train
from manip.programs.evaluate import Evaluate
from manip.training.config import RENAMED, TrainConfig, from_dict, to_dict

SPACES = Spaces(observation_dim=5, action_dim=7)

DATACLASSES = [TrainConfig, *(load_algorithm(n).Config for n in algorithm_names())]

SMALL = {
    *("steps", "num_envs", "horizon", "eval_every", "eval_episodes", "threads"),
    *("n_step", "batch_size", "buffer_size", "actor_delay", "critics", "workers"),
    *("rollout_length", "epochs", "minibatches", "noise_steps", "bins"),
    *("actor_hidden", "critic_hidden"),
}
"""Options that cost memory or time as they grow."""

odd = (
    st.none()
    | st.booleans()
    | st.integers(-(10**400), 10**400)
    | st.floats()
    | st.text(max_size=8)
    | st.lists(st.integers(-1, 9) | st.floats() | st.text(max_size=3), max_size=3)
    | st.dictionaries(st.text(max_size=3) | st.integers(), st.integers(), max_size=2)
)
"""What a hand, or a damaged file, may write where an option should be."""


def kinds(cls: type, name: str) -> set[Any]:
    """Types of number that an option may be, or hold."""
    hint = get_type_hints(cls)[name]
    parts = get_args(hint) if isinstance(hint, UnionType) else (hint,)
    held = [get_args(p)[0] if get_origin(p) is tuple else p for p in parts]
    return {kind for kind in held if kind in (int, float)}


def numbers(cls: type) -> list[str]:
    return [field.name for field in fields(cls) if kinds(cls, field.name)]


@pytest.mark.parametrize("cls", DATACLASSES)
def test_every_number_has_a_range_that_its_default_keeps(cls: type) -> None:
    assert set(numbers(cls)) == set(ranges_of(cls))
    cls()


@dataclass(frozen=True)
class Own:
    """Options of a user's own algorithm."""

    beta: Annotated[float, Range(0.5, 2)] = 1.0
    widths: Annotated[tuple[int, ...], Range(1, 9)] = (4,)
    bare: float | None = None


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"beta": 0.4}, "beta must be at least 0.5, not 0.4"),
        ({"beta": 3.0}, "beta must be at most 2, not 3.0"),
        ({"widths": (4, 0)}, "widths must be at least 1, not 0"),
        ({"bare": math.nan}, "bare must be a finite number, not nan"),
    ],
)
def test_ranges_of_any_dataclass_are_checked(values, message) -> None:
    check_options(Own())
    with pytest.raises(UserError) as error:
        check_options(Own(**values))
    assert str(error.value) == message


@pytest.mark.parametrize(("old", "new"), RENAMED.items())
def test_an_old_name_of_an_option_leads_to_the_new_one(old: str, new: str) -> None:
    with pytest.raises(UserError, match=f"the option {old} is now called {new}"):
        from_dict({old: 1})


@st.composite
def likely(draw: st.DrawFn, cls: type, name: str) -> Any:
    """A value at, in or just out of an option's range, of the right type or not."""
    allowed = ranges_of(cls)[name]
    least, most = allowed.least, allowed.most
    most = min(most, 9) if name in SMALL else most
    number = st.sampled_from([least, most, least - 1, most + 1])
    if float in kinds(cls, name):
        number |= st.floats(least, most) | st.sampled_from([float("nan"), 1e300])
    else:
        number |= st.integers(int(least), int(most))
    many = get_origin(get_type_hints(cls)[name]) is tuple
    return draw(st.lists(number, max_size=3) if many else number)


@st.composite
def configurations(draw: st.DrawFn) -> dict[str, Any]:
    """A configuration of which two options or so are not as they should be."""
    algo = draw(st.sampled_from(algorithm_names()))
    cls = load_algorithm(algo).Config
    values: dict[str, Any] = {"algo": algo, "agent": {}}
    for name in draw(st.lists(st.sampled_from(numbers(cls)), max_size=3)):
        values["agent"][name] = draw(likely(cls, name) | odd)
    for field in draw(st.lists(st.sampled_from(fields(TrainConfig)), max_size=2)):
        if field.name not in ("agent", "algo"):
            values[field.name] = draw(odd)
    return values


patient = settings(deadline=None, suppress_health_check=[HealthCheck.too_slow])


def built(values: dict[str, Any]) -> TrainConfig | str:
    """The configuration, if an agent can be built by it, or why it cannot."""
    try:
        config = from_dict(values)
        load_algorithm(config.algo)(config.agent, SPACES)
    except UserError as error:
        return str(error)
    return config


def assert_built_or_refused(values: dict[str, Any]) -> None:
    config = built(values)
    if isinstance(config, str):
        assert "\n" not in config
        return
    written = yaml.safe_load(yaml.safe_dump(to_dict(config)))
    assert from_dict(written) == replace(config, out=config.folder)


@settings(patient, max_examples=60, derandomize=True)
@given(configurations() | st.fixed_dictionaries({"algo": odd, "agent": odd}))
@example({"out": 3})
@example({"task": 3})
@example({3: 4, None: 5})
def test_any_configuration_is_built_or_refused_in_a_line(values) -> None:
    assert_built_or_refused(values)


@pytest.mark.slow
@settings(patient, max_examples=3000)
@given(configurations())
def test_thousands_of_configurations_are_built_or_refused(values) -> None:
    assert_built_or_refused(values)


# Command lines

PROGRAMS = {
    program.__name__.rpartition(".")[2]: program
    for program in (train, evaluate, render, replay)
}

flags = st.sampled_from(
    [
        f"--{'no-' * off}{prefix}{field.name.replace('_', '-')}"
        for prefix, cls in (("", TrainConfig), ("agent.", SACConfig), ("", Evaluate))
        for field in fields(cls)
        for off in (False, True)
    ]
)
words = st.sampled_from(
    [
        *("", "-", "--", "-1", "0", "3", "1e400", "nan", "None", "True", "[", "{}"),
        *("Lift", "Reach", "ppo", "sac", "nowhere", "a:b", ":", "/", "..:x", "x/y"),
        *("robosuite/Lft", "exact", "native", "Panda", "--steps=2", "/dev/null"),
    ]
)
command_lines = st.lists(flags | words | st.text(max_size=5), max_size=6)


def unwilling(config: TrainConfig, **_: Any) -> None:
    """Train never."""
    raise UserError(f"not today: {config.steps}")


def assert_answered_in_a_line(program: str, line: list[str], patch, capfd) -> None:
    patch.setattr(train, "train", unwilling)
    capfd.readouterr()
    code = cli.run(PROGRAMS[program].main, line)
    printed = capfd.readouterr().err
    assert code == 2
    assert printed.startswith("manip: error: ")
    assert printed.count("\n") == 1, printed


careful = settings(
    patient,
    suppress_health_check=[HealthCheck.too_slow, HealthCheck.function_scoped_fixture],
)


@settings(careful, max_examples=25, derandomize=True)
@given(program=st.sampled_from(sorted(PROGRAMS)), line=command_lines)
@example(program="train", line=["--task", "..:x"])
@example(program="train", line=["--agent.action-scale"])
@example(program="evaluate", line=["\0"])
@example(program="replay", line=["/dev/null"])
def test_any_command_line_is_answered_in_a_line(
    program: str, line: list[str], monkeypatch, capfd, tmp_path: Path
) -> None:
    monkeypatch.chdir(tmp_path)
    assert_answered_in_a_line(program, line, monkeypatch, capfd)


@pytest.mark.slow
@settings(careful, max_examples=1000)
@given(program=st.sampled_from(sorted(PROGRAMS)), line=command_lines)
def test_a_thousand_command_lines_are_answered_in_a_line(
    program: str, line: list[str], monkeypatch, capfd, tmp_path: Path
) -> None:
    monkeypatch.chdir(tmp_path)
    assert_answered_in_a_line(program, line, monkeypatch, capfd)
