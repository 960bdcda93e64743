"""Write policies for other programs: ONNX, TorchScript, numpy arrays.

Every file holds the network, with the normaliser of its observations inside, and the
policy's card and the form of the network as JSON. Inputs are the parts of the card's
`observation`: `observation` [N, D] float32, all that are no cameras, flattened and
joined in order; then the image of each camera, uint8 [N, H, W, C]. The output is
`action` [N, A] in [-1, 1].
"""

import json
import warnings
from collections.abc import Callable, Sequence
from copy import deepcopy
from pathlib import Path
from typing import Literal

import numpy as np
import torch
from torch import Tensor, nn

from manip.agents.image_actor import ImageActor
from manip.agents.policy import AnyActor, Policy
from manip.deploy.exported_policy import open_policy
from manip.errors import UserError
from manip.io.atomic_files import replace_file
from manip.observation import ObservationPart

Format = Literal["onnx", "torchscript", "numpy"]

SUFFIXES: dict[Format, str] = {"onnx": ".onnx", "torchscript": ".pt", "numpy": ".npz"}
"""Format -> ending of its files."""

METADATA = "manip"
"""Name of the JSON text in the metadata of ONNX and TorchScript files."""

TOLERANCE = {"onnx": 1e-5, "torchscript": 1e-6, "numpy": 1e-6}
"""Largest difference of an action, in -1..1, from that of the policy."""

OPSET = 17
"""Version of ONNX's operators."""

CHECKED = 256
"""Observations on which a file is compared with the policy."""


class _Deployed(nn.Module):
    """The deterministic action of an actor, as a module."""

    def __init__(self, actor: AnyActor) -> None:
        super().__init__()
        self.actor = actor

    def forward(self, observation: Tensor, *images: Tensor) -> Tensor:
        return self.actor.decide(observation, *images)


def export_policy(policy: Policy, form: Format, path: Path) -> float:
    """Write a policy in a format, after a comparison with the policy itself.

    Returns:
        The largest difference of an action from the policy's.

    Raises:
        UserError: a library is missing, the format does not hold such a policy, or the
            file acts differently.
    """
    writers: dict[Format, Callable[[Policy, Path], object]] = {
        "onnx": _write_onnx,
        "torchscript": _write_torchscript,
        "numpy": _write_numpy,
    }
    differences: list[float] = []

    def write(temporary: Path) -> None:
        writers[form](policy, temporary)
        differences.append(_difference(policy, form, temporary))

    replace_file(path, write)
    return differences[0]


def examples(policy: Policy, count: int) -> list[Tensor]:
    """Random inputs of a policy: the joined observation, then an image a camera."""
    generator = torch.Generator().manual_seed(0)
    vector = torch.randn(
        count, policy.card.observation_dim, generator=generator, dtype=torch.float
    )
    images = [
        torch.randint(0, 256, (count, *part.shape), generator=generator).byte()
        for part in _cameras(policy)
    ]
    return [vector, *images]


def _difference(policy: Policy, form: Format, path: Path) -> float:
    """Compare the actions of a file with the policy's.

    Raises:
        UserError: they differ by more than rounding.
    """
    inputs = examples(policy, CHECKED)
    actions, expected = _actions(policy, form, path, inputs)
    worst = (actions - expected).abs().amax(1)
    # Two bins of nearly equal value may be exchanged by rounding.
    result = float(worst.quantile(0.98) if policy.card.bins else worst.max())
    if not result <= TOLERANCE[form]:
        raise UserError(
            f"the {form} file acts differently from the policy by {result:.1e}, more "
            f"than {TOLERANCE[form]:.0e}: nothing was written"
        )
    return result


@torch.no_grad()
def _actions(
    policy: Policy, form: Format, path: Path, inputs: list[Tensor]
) -> tuple[Tensor, Tensor]:
    """Actions of a file and of the policy; numpy's are computed in float64."""
    actor = policy.actor
    if form == "torchscript":
        with warnings.catch_warnings():  # torch.jit is deprecated, and stays
            warnings.simplefilter("ignore")
            return torch.jit.load(path)(*inputs), actor.decide(*inputs)
    if form == "numpy":
        actor, inputs = deepcopy(actor).double(), [inputs[0].double()]
    _, act = open_policy(str(path))
    actions = np.asarray(act(*(i.numpy() for i in inputs)))
    return torch.from_numpy(actions), actor.decide(*inputs)


def _names(policy: Policy) -> list[str]:
    return ["observation", *(p.name for p in _cameras(policy))]


def _cameras(policy: Policy) -> Sequence[ObservationPart]:
    return [p for p in policy.card.observation_spec.parts if p.role == "camera"]


def _text(policy: Policy) -> str:
    return json.dumps(policy.described)


def _write_onnx(policy: Policy, path: Path) -> None:
    try:
        import onnx
        import onnxruntime  # noqa: F401
    except ImportError as error:
        raise UserError(
            f"--format onnx needs {error.name}: pip install onnx onnxruntime (the "
            "extra `export`)"
        ) from None
    names = _names(policy)
    with warnings.catch_warnings():  # the exporter of traced modules is "legacy"
        warnings.simplefilter("ignore")
        torch.onnx.export(
            _Deployed(policy.actor).eval(),
            tuple(examples(policy, 2)),
            str(path),
            input_names=names,
            output_names=["action"],
            dynamic_axes={name: {0: "N"} for name in [*names, "action"]},
            opset_version=OPSET,
            dynamo=False,
        )
    model = onnx.load(str(path))
    onnx.helper.set_model_props(model, {METADATA: _text(policy)})
    onnx.checker.check_model(model, full_check=True)
    onnx.save(model, str(path))


def _write_torchscript(policy: Policy, path: Path) -> None:
    with warnings.catch_warnings():  # of shapes that the tracer takes as constants
        warnings.simplefilter("ignore")
        traced = torch.jit.trace(_Deployed(policy.actor).eval(), examples(policy, 2))
        traced.save(str(path), _extra_files={f"{METADATA}.json": _text(policy)})


def _write_numpy(policy: Policy, path: Path) -> None:
    if isinstance(policy.actor, ImageActor):
        raise UserError(
            "--format numpy is for policies that see the state: choose onnx or "
            "torchscript for one that sees cameras"
        )
    weights = {name: w.numpy() for name, w in policy.actor.state_dict().items()}
    with path.open("wb") as file:
        np.savez(file, card=np.array(_text(policy)), **weights)
