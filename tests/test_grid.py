"""Grids of options: what a command line and a YAML file mean."""

from pathlib import Path

import pytest

from manip.cluster.grid import Grid, cells_of, grid_of_arguments, plain_grid
from manip.cluster.sweep_folder import read_grids, write_grids
from manip.errors import UserError

GRIDS = [
    "--task Lift Stack --algo sac td3 --seed 0:5 --agent.gamma 0.95 0.97",
    "--agent.actor-hidden 64 64 --agent.actor-hidden 16 --reward-weights a=1 b=2",
    "--overlap --no-overlap --seed 3 7:9 --steps=1e5",
    "--algo ppo --agent.action-scale 1 -0.5 --agent.clip None",
]


def grid_of(text: str) -> Grid:
    return grid_of_arguments(text.split())


def arguments_of(text: str) -> list[str]:
    return [" ".join(cell.arguments) for cell in cells_of(grid_of(text))]


def test_a_grid_is_the_product_of_its_choices() -> None:
    cells = cells_of(grid_of(GRIDS[0]))
    assert len(cells) == 2 * 2 * 5 * 2
    assert [cell.seed for cell in cells[:6]] == [0, 1, 2, 3, 4, 0]
    assert arguments_of(GRIDS[0])[5] == "--task Lift --algo sac --agent.gamma 0.97"
    assert cells[-1].values == {"task": "Stack", "algo": "td3", "agent.gamma": "0.97"}


def test_options_that_take_lists_are_repeated() -> None:
    weights = "--reward-weights a=1 b=2"
    assert arguments_of(GRIDS[1]) == [
        f"--agent.actor-hidden 64 64 {weights}",
        f"--agent.actor-hidden 16 {weights}",
    ]


def test_options_that_are_on_or_off_are_repeated() -> None:
    grid = grid_of(GRIDS[2])
    assert [cell.seed for cell in cells_of(grid)] == [3, 7, 8] * 2
    assert arguments_of(GRIDS[2])[::3] == [
        "--overlap --steps 1e5",
        "--no-overlap --steps 1e5",
    ]


def test_a_grid_without_seeds_has_seed_0() -> None:
    assert [cell.seed for cell in cells_of(grid_of("--task Lift"))] == [0]
    assert len(cells_of(grid_of(""))) == 1


@pytest.mark.parametrize("text", GRIDS)
def test_a_grid_is_read_as_it_was_written(text: str, tmp_path: Path) -> None:
    grid = grid_of(text)
    write_grids(tmp_path, [grid])
    (stored,) = read_grids(tmp_path / "sweep.yaml")
    assert stored == grid
    write_grids(tmp_path, [grid, {}])
    assert read_grids(tmp_path / "sweep.yaml") == [grid, {}]
    assert plain_grid(stored) == plain_grid(grid)


def test_yaml_is_read_as_text(tmp_path: Path) -> None:
    """In YAML 1.1, 1:5 would be the number 65, and 1e5 text."""
    path = tmp_path / "grid.yaml"
    path.write_text(
        """
        task: [Lift, Stack]
        seed: 1:5
        steps: 1e5
        overlap: [true, false]
        agent: {gamma: [0.95, 0.970], actor_hidden: [64, 64]}
        """
    )
    (grid,) = read_grids(path)
    expected = "--task Lift Stack --seed 1:5 --steps 1e5 --overlap --no-overlap"
    lists = "--agent.gamma 0.95 0.970 --agent.actor-hidden 64 64"
    assert grid == grid_of(f"{expected} {lists}")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("Lift", "'Lift' belongs to no option"),
        ("--seed 5:5", "--seed 5:5 must be 1 to 10,000 seeds"),
        ("--seed 0:99999999", "must be 1 to 10,000 seeds"),
        ("--seed -1", "--seed takes numbers or ranges such as 0:5, not '-1'"),
        ("--seed", "--seed takes numbers or ranges such as 0:5, not 'true'"),
        ("--resume", "--resume cannot be an option of a grid"),
        ("--preferences a", "--preferences cannot be an option of a grid"),
        ("--algo sac sax", "unknown algorithm 'sax': did you mean 'sac'"),
    ],
)
def test_mistakes_in_arguments_are_named(text: str, message: str) -> None:
    with pytest.raises(UserError, match=message):
        grid_of(text)


def test_a_grid_has_an_end() -> None:
    seeds = " ".join(map(str, range(101)))
    with pytest.raises(UserError, match="a grid of 10,100 runs: at most 10,000"):
        cells_of(grid_of(f"--steps {seeds} --seed 0:100"))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[]", "holds no grid"),
        ("5", "a grid must be a mapping of options, not '5'"),
        ("{a: [[b, [c]]]}", "a must be a value or a list of values"),
        ("{a: []}", "a has no value"),
        ("{a: &x 1, b: *x}", "anchors and aliases"),
    ],
)
def test_mistakes_in_files_are_named(text: str, message: str, tmp_path: Path) -> None:
    (tmp_path / "grid.yaml").write_text(text)
    with pytest.raises(UserError, match=message):
        read_grids(tmp_path / "grid.yaml")
    with pytest.raises(UserError, match="there is no file nowhere"):
        read_grids(Path("nowhere"))
