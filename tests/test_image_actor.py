"""Actors that see images: their inputs, shapes, and the shift of images."""

import numpy as np
import pytest
import torch
from tensordict import TensorDict

from manip.agents.actor_inputs import ActorInputs, camera_inputs, seen_parts
from manip.agents.agent import Spaces
from manip.agents.image_actor import ImageActor
from manip.agents.image_encoder import ImageEncoder, random_shift
from manip.agents.make_actor import ImageConfig, make_actor
from manip.agents.networks import Actor
from manip.errors import UserError
from manip.observation import ObservationPart, ObservationSpec

SPEC = ObservationSpec(
    (
        ObservationPart("joint_pos", (2,), "float32", "proprioception"),
        ObservationPart("cube", (3,), "float32", "object"),
        ObservationPart("eef_pos", (1,), "float32", "proprioception"),
        ObservationPart("wrist_image", (16, 16, 3), "uint8", "camera"),
        ObservationPart("front_image", (12, 12, 6), "uint8", "camera"),
    )
)
"""An observation with D = 6 and two cameras."""


def state_of(*shape: int) -> TensorDict:
    images = {
        camera.name: torch.randint(256, (*shape, *camera.shape), dtype=torch.uint8)
        for camera in SPEC.parts[-2:]
    }
    return TensorDict({"observation": torch.rand(*shape, 6), **images}, shape)


def actor_of(inputs: ActorInputs, normalise: bool = False) -> Actor | ImageActor:
    torch.manual_seed(0)
    spaces = Spaces(6, 2, inputs)
    options = ImageConfig(image_channels=(4, 8), image_features=5)
    return make_actor(spaces, options, (16,), squash=True, normalise=normalise)


def test_an_actor_sees_proprioception_and_cameras_but_no_objects() -> None:
    inputs, state = camera_inputs(SPEC), state_of(4)
    vector, *images = inputs.of(state)
    assert torch.equal(vector, state["observation"][:, [0, 1, 5]])
    assert inputs.keys == ("observation", "wrist_image", "front_image")
    assert [image.shape for image in images] == [(4, 16, 16, 3), (4, 12, 12, 6)]
    visible = ("joint_pos", "eef_pos", "wrist_image", "front_image")
    assert seen_parts(SPEC, inputs).names == visible


def test_other_parts_are_seen_by_name_in_the_order_of_the_observation() -> None:
    inputs = camera_inputs(SPEC, ("eef_pos", "cube"))
    assert inputs.columns == (2, 3, 4, 5)
    assert seen_parts(SPEC, inputs).names[:2] == ("cube", "eef_pos")
    for wrong in ("cup", "wrist_image"):
        with pytest.raises(UserError, match=f"part {wrong!r}"):
            camera_inputs(SPEC, (wrong,))


def test_without_choice_the_actor_sees_the_joined_vector_itself() -> None:
    state = state_of(4)
    (vector,) = ActorInputs().of(state)
    assert vector.data_ptr() == state["observation"].data_ptr()
    assert seen_parts(SPEC, ActorInputs()).names == ("joint_pos", "cube", "eef_pos")
    assert isinstance(actor_of(ActorInputs()), Actor)


@pytest.mark.parametrize("shape", [(4,), (2, 3), (1, 2, 2)])
@pytest.mark.parametrize("normalise", [False, True])
def test_actions_have_the_leading_shape_of_the_state(shape, normalise) -> None:
    inputs = camera_inputs(SPEC)
    actor, state = actor_of(inputs, normalise), state_of(*shape)
    loc, scale = actor(*inputs.of(state))
    assert loc.shape == scale.shape == (*shape, 2)
    decided = actor.decide(*inputs.of(state))
    assert decided.abs().max() <= 1
    torch.testing.assert_close(decided, loc.tanh())


def test_a_batch_acts_as_its_rows_alone() -> None:
    inputs = camera_inputs(SPEC)
    actor, state = actor_of(inputs), state_of(5)
    together = actor.decide(*inputs.of(state))
    alone = [actor.decide(*inputs.of(state[i : i + 1])) for i in range(5)]
    torch.testing.assert_close(together, torch.cat(alone))


@pytest.mark.parametrize("camera", [0, 1])
def test_each_image_and_the_vector_change_the_action(camera: int) -> None:
    inputs, state = camera_inputs(SPEC), state_of(3)
    actor = actor_of(inputs)
    vector, *images = inputs.of(state)
    before = actor.decide(vector, *images)
    images[camera] = 255 - images[camera]
    assert not torch.equal(actor.decide(vector, *images), before)
    assert not torch.equal(actor.decide(vector + 1, *inputs.of(state)[1:]), before)


@pytest.mark.parametrize("size", [8, 9, 16, 31, 64])
def test_encoders_take_images_of_any_size(size: int) -> None:
    encoder = ImageEncoder((size, size, 3), (4, 4, 4), 7)
    image = torch.randint(256, (2, size, size, 3), dtype=torch.uint8)
    features = encoder(image)
    assert features.shape == (2, 7)
    assert features.min() >= 0


def test_a_shift_crops_the_image_with_repeated_edges() -> None:
    torch.manual_seed(0)
    image = torch.randint(256, (64, 6, 5, 3), dtype=torch.uint8)
    shifted = random_shift(image, 2)
    padding = ((0, 0), (2, 2), (2, 2), (0, 0))
    padded = np.pad(image.numpy(), padding, mode="edge")
    offsets = set()
    for index, result in enumerate(shifted.numpy()):
        crops = {
            (row, column): padded[index, row : row + 6, column : column + 5]
            for row in range(5)
            for column in range(5)
        }
        same = [place for place, crop in crops.items() if np.array_equal(crop, result)]
        assert len(same) == 1
        offsets.update(same)
    assert len(offsets) > 18  # of 25


def test_a_shift_of_zero_is_no_shift() -> None:
    image = torch.randint(256, (3, 4, 4, 3), dtype=torch.uint8)
    assert random_shift(image, 0) is image
