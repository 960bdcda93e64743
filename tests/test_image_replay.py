"""Replay with images: the laws of test_replay hold for each transition's images."""

import resource

import pytest
import torch
from tensordict import TensorDict, TensorDictBase
from test_replay import GAMMA, rollout

from manip.agents.replay import Replay
from manip.agents.replay_columns import row_bytes
from manip.errors import UserError
from manip.observation import ObservationPart

CAMERAS = tuple(
    ObservationPart(name, shape, "uint8", "camera")
    for name, shape in (("wrist_image", (2, 2, 3)), ("front_image", (1, 3, 6)))
)


def image_of(observation: torch.Tensor, camera: ObservationPart) -> torch.Tensor:
    """An image [..., H, W, C] whose first two bytes are twice the observation."""
    number = (2 * observation[..., 0]).long()
    image = torch.zeros(*number.shape, *camera.shape, dtype=torch.uint8)
    image[..., 0, 0, 0], image[..., 0, 0, 1] = number % 256, number // 256
    return image


def number_in(image: torch.Tensor) -> torch.Tensor:
    """The observation that an image shows."""
    first = image[..., 0, 0, :2].float()
    return (first[..., 0] + 256 * first[..., 1]) / 2


def drawn(first: int, ends: str, env: int = 0) -> TensorDict:
    """Steps as `rollout` gives them, with images of each state and successor."""
    steps = rollout(first, ends, env)
    for state in (steps, steps["next"]):
        for camera in CAMERAS:
            state[camera.name] = image_of(state["observation"], camera)
    return steps


def replay_of(*rollouts: TensorDictBase, capacity: int = 20) -> Replay:
    replay = Replay(capacity, observation_dim=1, action_dim=1, cameras=CAMERAS)
    for batch in rollouts:
        replay.add(batch)
    return replay


def assert_images_belong(replay: Replay, n: int) -> None:
    """Each transition's images show its state and its successor."""
    rows = torch.arange(len(replay))
    batch = replay.image_transitions(rows, n, GAMMA)
    assert torch.equal(batch.rows, replay.transitions(rows, n, GAMMA))
    for camera in CAMERAS:
        assert torch.equal(number_in(batch.images[camera.name]), batch.rows[:, 0])
        assert torch.equal(number_in(batch.successors[camera.name]), batch.rows[:, 2])


@pytest.mark.parametrize("n", [1, 2, 3, 20])
@pytest.mark.parametrize("ends", ["..t.|...", "......", "tttttt", ".....|"])
def test_images_are_those_of_the_state_and_of_the_n_th_successor(ends, n) -> None:
    assert_images_belong(replay_of(drawn(0, ends)), n)
    pieces = [drawn(at, ends[at : at + 3]) for at in range(0, len(ends), 3)]
    assert_images_belong(replay_of(*pieces), n)


@pytest.mark.parametrize("capacity", [5, 7, 17])
@pytest.mark.parametrize("n", [1, 3])
def test_a_ring_of_several_environments_never_mixes_images(capacity, n) -> None:
    torch.manual_seed(0)
    replay, envs = replay_of(capacity=capacity), 1 + (capacity > 8) * 2
    for at in range(0, 60, 4):
        ends = ["".join(".t|"[i] for i in torch.randint(3, (4,))) for _ in range(envs)]
        replay.add(torch.cat([drawn(at, e, env) for env, e in enumerate(ends)]))
        assert_images_belong(replay, n)


def test_a_restored_buffer_equals_the_saved_one_and_goes_on_as_it_does() -> None:
    replay, again = replay_of(drawn(0, "..t."), capacity=6), replay_of(capacity=6)
    again.load_state(replay.state(rows=True))
    for buffer in (replay, again):
        buffer.add(drawn(4, ".|."))
        assert_images_belong(buffer, n=3)
    first, second = (buffer.state(rows=True)["buffer"] for buffer in (replay, again))
    assert all(torch.equal(first[name], second[name]) for name in first)


def test_a_buffer_without_these_cameras_is_refused() -> None:
    saved = replay_of(drawn(0, "...")).state(rows=True)
    with pytest.raises(ValueError, match=r"a replay buffer of columns .*wrist_image"):
        Replay(20, 1, 1).load_state(saved)
    saved["buffer"]["after:wrist_image"] = torch.zeros(3, 2, 2, 3)
    with pytest.raises(ValueError, match=r"after:wrist_image .* is torch\.float"):
        replay_of().load_state(saved)


def test_images_count_in_the_memory_of_a_step() -> None:
    assert row_bytes(1, 1) == 12
    assert row_bytes(1, 1, CAMERAS) == 12 + 2 * (12 + 18)
    huge = ObservationPart("huge_image", (2**20, 2**20, 3), "uint8", "camera")
    with pytest.raises(UserError, match=r"no memory for .*GiB\): choose a smaller"):
        Replay(10, 1, 1, [huge])


def test_images_take_memory_only_where_they_have_been_written() -> None:
    """Ten gigabytes are reserved; a hundred steps take some kilobytes of them."""
    camera = ObservationPart("wrist_image", (64, 64, 3), "uint8", "camera")
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    replay = Replay(400_000, 1, 1, [camera])
    steps = rollout(0, "." * 100)
    for state in (steps, steps["next"]):
        state[camera.name] = torch.ones(1, 100, *camera.shape, dtype=torch.uint8)
    replay.add(steps)
    taken = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before
    assert taken < 200_000  # KiB
