"""Perturbations: what they change, and that the nominal task stays as it is."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from sameness import assert_same

from manip.envs import make_batch
from manip.envs.backends.native_batch import NativeBatch
from manip.envs.episode_draws import CHUNK, EpisodeDraws
from manip.envs.perturbation import QUANTITIES, Perturbation, perturbations_of
from manip.errors import UserError
from manip.sim.scene import Scene, load_scene
from manip.tasks.lift import Lift

Array = np.ndarray

ENVS, STEPS = 3, 12

CHANGED = {
    "object_mass": 3.0, "object_size": 1.2, "friction": 0.3, "gripper_force": 0.5,
    "joint_damping": 3.0, "controller_stiffness": 0.6, "start_noise": 2.0,
}  # fmt: skip
"""A value of each quantity of the model."""

MEASURED = {
    "observation_delay", "object_position", "object_yaw", "hand_position",
    "joint_position", "joint_velocity",
}  # fmt: skip
"""Quantities that change what is observed, not what happens."""


@pytest.fixture(scope="module")
def scene() -> Scene:
    return load_scene("Lift", Lift.sensors, fidelity="fast")


def lift(scene: Scene, *perturbations: dict, **options: Any) -> NativeBatch:
    given = perturbations_of(perturbations) if perturbations else ()
    return NativeBatch(
        Lift(), ENVS, scene=scene, threads=1, perturbations=given, **options
    )


def constant(quantity: str, value: float) -> dict:
    return {"quantity": quantity, "constant": value}


def play(batch: NativeBatch, steps: int = STEPS) -> list[tuple[Array, Array]]:
    """Poses [N, nq] and observations [N, D] of some steps of the first episodes."""
    batch.begin(np.arange(ENVS))
    rng, played = np.random.default_rng(0), []
    for _ in range(steps):
        observation = batch.step(rng.uniform(-1, 1, (ENVS, 7))).observation
        played.append((batch.read()["qpos"].copy(), observation.copy()))
    return played


def same(first: list, second: list, item: int) -> bool:
    pairs = zip(first, second, strict=True)
    return all(np.array_equal(a[item], b[item]) for a, b in pairs)


@pytest.fixture(scope="module")
def nominal(scene: Scene) -> list:
    return play(lift(scene))


def test_nominal_values_change_no_bit(scene: Scene, nominal: list) -> None:
    everything = [constant(name, kind.nominal) for name, kind in QUANTITIES.items()]
    played = play(lift(scene, *everything))
    assert same(played, nominal, 0)
    assert same(played, nominal, 1)


@pytest.mark.parametrize("quantity", QUANTITIES)
def test_a_quantity_changes_what_happens_or_what_is_observed(
    scene: Scene, nominal: list, quantity: str
) -> None:
    kind = QUANTITIES[quantity]
    value = CHANGED.get(quantity, 2.0 if "delay" in quantity else 0.05)
    played = play(lift(scene, constant(quantity, value)), 3)
    expected = nominal[:3]
    assert same(played, expected, 0) == (quantity in MEASURED)
    assert not same(played, expected, 1)
    assert kind.of_model == (quantity in CHANGED)


def test_derived_constants_are_those_of_a_compiled_model(scene: Scene) -> None:
    batch = lift(scene, constant("object_mass", 4.0))
    batch.begin(np.arange(ENVS))
    row, cube = batch.engine.states[0], scene.physics.body("cube_main").id
    compiled = scene.physics
    for array, factor in (
        ("body_mass", 4.0),
        ("body_subtreemass", 4.0),
        ("body_invweight0", 0.25),
    ):
        part = row[batch.engine.state_columns(f"varied {array}")]
        values = part.reshape(getattr(compiled, array).shape)
        np.testing.assert_allclose(
            values[cube], factor * getattr(compiled, array)[cube]
        )
        arm = scene.layout.robots[0].arm.root
        np.testing.assert_array_equal(values[arm], getattr(compiled, array)[arm])


def test_a_delayed_action_acts_later(scene: Scene) -> None:
    delayed, prompt = lift(scene, constant("action_delay", 2.0)), lift(scene)
    push, rest = np.full((ENVS, 7), 0.7), np.zeros((ENVS, 7))
    for batch, actions in (
        (delayed, (push, push, push, push)),
        (prompt, (rest, rest, push, push)),
    ):
        batch.begin(np.arange(ENVS))
        for action in actions:
            batch.step(action)
    assert_same(delayed.read()["qpos"], prompt.read()["qpos"])


def test_a_delayed_observation_is_that_of_earlier_steps(
    scene: Scene, nominal: list
) -> None:
    played = play(lift(scene, constant("observation_delay", 3.0)))
    for step in range(3, STEPS):
        np.testing.assert_array_equal(played[step][1], nominal[step - 3][1])
    np.testing.assert_array_equal(played[0][1], played[1][1])


def test_errors_of_measurement_are_consistent_and_unknown_to_the_reward(
    scene: Scene, nominal: list
) -> None:
    batch = lift(scene, {"quantity": "object_position", "normal": 0.01})
    played = play(batch)
    slices = batch.observation_spec.slices
    error = played[0][1] - nominal[0][1]
    cube = error[:, slices["cube_pos"]] / 4
    np.testing.assert_allclose(error[:, slices["to_cube"]] / 10, cube, atol=1e-6)
    assert 0.001 < np.abs(cube).mean() < 0.05
    assert len(np.unique(cube)) == cube.size
    last = played[-1][1] - nominal[-1][1]
    np.testing.assert_allclose(last[:, slices["cube_pos"]] / 4, cube, atol=1e-6)
    np.testing.assert_array_equal(error[:, slices["joint_pos"]], 0)


MANY = (
    {"quantity": "object_mass", "loguniform": [0.5, 4.0]},
    {"quantity": "controller_stiffness", "uniform": [0.5, 1.5]},
    {"quantity": "action_delay", "choice": [0, 1, 2], "per": "step"},
    {"quantity": "object_position", "normal": 0.01, "per": "step"},
    {"quantity": "object_position", "uniform": [-0.02, 0.02]},
    {"quantity": "observation_delay", "choice": [0, 2]},
)


def test_episodes_depend_on_their_seed_and_number_only(scene: Scene) -> None:
    together = play(lift(scene, *MANY))
    options = {"scene": scene, "first_env": 2, "perturbations": perturbations_of(MANY)}
    alone = NativeBatch(Lift(), 1, **options)
    alone.begin(np.arange(1))
    rng = np.random.default_rng(0)
    for _, observation in together:
        action = rng.uniform(-1, 1, (ENVS, 7))[2:]
        np.testing.assert_array_equal(alone.step(action).observation[0], observation[2])
    assert not same(together, play(lift(scene, *MANY, seed=1)), 1)


@pytest.mark.parametrize("per", ["episode", "step"])
def test_a_share_of_the_episodes_is_perturbed(per: str) -> None:
    given = Perturbation("action", normal=0.1, per=per, share=0.25)
    draws, numbers = EpisodeDraws(given, 1000, 7), np.arange(1000)
    draws.begin(numbers, 0, 0, numbers, numbers)
    first, later = (draws.at(np.full(1000, step)) for step in (0, CHUNK + 1))
    perturbed = first.any(1)
    assert 0.2 < perturbed.mean() < 0.3
    assert (perturbed == later.any(1)).all()
    whole = EpisodeDraws(replace(given, share=1.0), 1000, 7)
    whole.begin(numbers, 0, 0, numbers, numbers)
    assert_same(first[perturbed], whole.at(np.zeros(1000, int))[perturbed])
    assert perturbations_of([given.to_dict()]) == (given,)


def test_a_saved_state_continues_bit_for_bit(scene: Scene) -> None:
    batch = lift(scene, *MANY)
    play(batch, 5)
    saved, copy = batch.save_state(), lift(scene, *MANY)
    copy.load_state(saved)
    assert_same(copy.observe().observation, batch.observe().observation)
    rng = np.random.default_rng(1)
    for _ in range(4):
        action = rng.uniform(-1, 1, (ENVS, 7))
        steps = [each.step(action) for each in (batch, copy)]
        assert_same(steps[1].observation, steps[0].observation)
    with pytest.raises(UserError, match="other perturbations"):
        lift(scene, *MANY[:3]).load_state(saved)


def test_stock_robosuite_is_perturbed_alike(scene: Scene) -> None:
    values = {n: v for n, v in CHANGED.items() if n != "start_noise"}
    given = perturbations_of([constant(name, value) for name, value in values.items()])
    stock = make_batch("Lift", backend="stock", perturbations=given)
    nominal, native = (
        NativeBatch(Lift(), 1, perturbations=each) for each in ((), given)
    )
    batches = (stock, nominal, native)
    for batch in batches:
        batch.begin(np.arange(1))
    start = stock.read()["qpos"]
    for batch in (nominal, native):
        batch.engine.reset(np.arange(1), start, _fields(batch))
    rng = np.random.default_rng(3)
    for _ in range(STEPS):
        action = rng.uniform(-1, 1, (1, 7))
        for batch in batches:
            batch.step(action)
    poses = [batch.read()["qpos"][0] for batch in batches]
    np.testing.assert_allclose(poses[2], poses[0], atol=1e-5)
    assert np.abs(poses[1] - poses[0]).max() > 1e-3


def _fields(batch: NativeBatch) -> dict[str, Array]:
    columns = {s.name: batch.engine.state_columns(s.name) for s in batch.scene.varied}
    return {name: batch.engine.states[:, part] for name, part in columns.items()}


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ([], "must be a list"),
        ([{"quantity": "mass", "constant": 1}], "unknown quantity 'mass'"),
        ([{"quantity": "friction"}], "one distribution"),
        ([{"quantity": "friction", "constant": 0}], "from 0.01 to 100"),
        ([{"quantity": "friction", "normal": 0.1}], "cannot be normal"),
        ([constant("friction", 0.5) | {"per": "step"}], "draw it per episode"),
        ([{"quantity": "friction", "uniform": [2.0, 1.0]}], "the smaller first"),
        ([constant("friction", 0.5)] * 2, "perturbed twice"),
        ([constant("friction", 0.5) | {"share": 0}], "share must be above 0"),
    ],
)
def test_impossible_perturbations_are_refused(values: list, words: str) -> None:
    with pytest.raises(UserError, match=words):
        perturbations_of(values)


def test_what_a_scene_lacks_is_refused(scene: Scene) -> None:
    with pytest.raises(UserError, match="no object that moves"):
        make_batch("Reach", perturbations=(Perturbation("object_mass", constant=2.0),))
    with pytest.raises(UserError, match="Perturbation"):
        NativeBatch(Lift(), 1, scene=scene, perturbations=("friction",))
