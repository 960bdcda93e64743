"""Observation specifications: parts, the joined vector, and the policy's check."""

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from manip.errors import UserError
from manip.observation import (
    ROLES,
    ObservationPart,
    ObservationSpec,
    check_observation,
    vector_spec,
)

Array = np.ndarray

SPEC = ObservationSpec(
    (
        ObservationPart("arm", (3,), "float32", "proprioception"),
        ObservationPart("picture", (4, 5, 3), "uint8", "camera"),
        ObservationPart("cubes", (2, 2), "float32", "object"),
        ObservationPart("nothing", (0,), "float32", "object"),
        ObservationPart("height", (1,), "float32", "object"),
    )
)


def parts(num_envs: int = 6) -> dict[str, Array]:
    rng = np.random.default_rng(0)
    return {part.name: rng.normal(size=(num_envs, *part.shape)) for part in SPEC.parts}


def test_the_vector_joins_all_parts_but_cameras_in_order() -> None:
    given_parts = parts()
    joined = SPEC.join(dict(reversed(given_parts.items())))
    flat = [given_parts[name].reshape(6, -1) for name in ("arm", "cubes", "height")]
    assert joined.dtype == np.float32
    np.testing.assert_array_equal(joined, np.concatenate(flat, 1).astype(np.float32))
    assert SPEC.dim == joined.shape[1] == 8


@pytest.mark.parametrize("kind", [np.asarray, torch.from_numpy])
def test_split_undoes_join_without_copies(kind) -> None:
    joined = SPEC.join(parts())
    split = SPEC.split(kind(joined))
    assert list(split) == ["arm", "cubes", "nothing", "height"]
    for name, part in split.items():
        expected = parts()[name].astype(np.float32)
        np.testing.assert_array_equal(np.asarray(part), expected)
    joined[:] = 7
    assert all((np.asarray(part) == 7).all() for part in split.values())
    for name, part in SPEC.split(kind(joined)[2]).items():
        assert tuple(part.shape) == parts()[name].shape[1:]


def test_selected_parts_come_in_the_order_asked_for() -> None:
    spec = SPEC.select(["height", "arm"])
    assert spec.names == ("height", "arm")
    np.testing.assert_array_equal(
        spec.join(parts()), SPEC.join(parts())[:, [7, 0, 1, 2]]
    )
    with pytest.raises(UserError, match="unknown observation part 'hight': did you"):
        SPEC.select(["hight"])


def test_numbers_beyond_float32_become_infinite_without_a_warning() -> None:
    spec = vector_spec({"a": np.zeros((1, 1))}, ())
    assert spec.join({"a": np.array([[1e300]])})[0, 0] == np.inf


def test_plain_values_describe_a_specification() -> None:
    plain = SPEC.to_dict()
    assert ObservationSpec.from_dict(plain) == SPEC
    assert plain[2] == {
        "name": "cubes", "shape": [2, 2], "dtype": "float32", "role": "object"
    }  # fmt: skip


PLAIN = {"name": "a", "shape": [1], "dtype": "float32", "role": "object"}


@pytest.mark.parametrize(
    "wrong",
    [
        5, "ab", [5], [{"name": "a"}], [PLAIN | {"more": 1}], [PLAIN, PLAIN],
        [PLAIN | {"name": 3}], [PLAIN | {"name": ""}],
        [PLAIN | {"shape": [-1]}], [PLAIN | {"shape": 3}], [PLAIN | {"shape": [0.5]}],
        [PLAIN | {"shape": [2**31]}], [PLAIN | {"shape": [2**16, 2**16]}],
        [PLAIN | {"dtype": "complex"}], [PLAIN | {"dtype": ["float32"]}],
        [PLAIN | {"role": "smell"}], [PLAIN | {"role": []}],
    ],
    ids=str,
)  # fmt: skip
def test_values_that_describe_none_are_refused(wrong) -> None:
    with pytest.raises(UserError) as error:
        ObservationSpec.from_dict(wrong)
    assert "\n" not in str(error.value)


@given(st.recursive(
    st.none() | st.integers() | st.text() | st.sampled_from(ROLES),
    lambda inner: st.lists(inner, max_size=3)
    | st.dictionaries(st.sampled_from(ObservationPart._fields), inner),
    max_leaves=8,
))  # fmt: skip
def test_any_values_are_a_specification_or_refused(values) -> None:
    try:
        spec = ObservationSpec.from_dict(values)
    except UserError:
        return
    assert ObservationSpec.from_dict(spec.to_dict()) == spec


def test_a_policy_may_need_fewer_parts_in_another_order() -> None:
    check_observation(SPEC.select(["height", "arm"]).to_dict(), SPEC)


def test_parts_that_differ_are_named() -> None:
    needed = [
        PLAIN | {"name": "arm", "shape": [2]},
        PLAIN | {"name": "cubes", "shape": [2, 2], "dtype": "float64"},
        PLAIN | {"name": "height"},
        PLAIN | {"name": "light"},
    ]
    message = (
        "another observation than the environment gives: arm is float32 [3], not "
        "float32 [2], cubes is float32 [2, 2], not float64 [2, 2], light is missing"
    )
    with pytest.raises(UserError) as error:
        check_observation(needed, SPEC)
    assert str(error.value).endswith(message)
