"""Errors of 1 % in lines of the gradient kernels are found before learning starts."""

import importlib
import sys
from pathlib import Path
from types import ModuleType

import pytest
from faulty_gradients import make_agent

from manip import compiled
from manip.agents import native
from manip.agents.native import ppo_gradients, sac_gradients

FOLDER = Path(native.__file__).parent
KERNELS = ("row_kernels", "mlp_kernels", "sac_kernels", "ppo_kernels")
PERCENT = "np.float32(1.01)"

ERRORS = [
    (
        *("sac", "sac_kernels", "value[:, r, 0].min()"),
        "np.float32(0.99) * value[:, r, 0].min() + np.float32(0.01) * value[0, r, 0]",
    ),
    ("sac", "sac_kernels", "value[:, r, 0].argmin()", "{} if r % 50 else 0"),
    ("sac", "sac_kernels", "- alpha * work.log_prob[r]", "{} * PERCENT"),
    ("sac", "sac_kernels", "TWO * error", "{} * PERCENT"),
    ("sac", "sac_kernels", "work.std[r, j] - alpha", "{} * PERCENT"),
    ("sac", "sac_kernels", "(ONE - spread * spread)", "{} * PERCENT"),
    ("sac", "sac_kernels", "alpha * TWO * t", "{} * PERCENT"),
    ("sac", "sac_kernels", "nets.action_scale[j] * (ONE - t * t)", "{} * PERCENT"),
    ("sac", "sac_kernels", "log_slope + np", "log_slope * PERCENT + np"),
    ("sac", "mlp_kernels", "- mean -", "- mean * PERCENT -"),
    ("sac", "mlp_kernels", "unit[i, j] * along", "{} * PERCENT"),
    ("sac", "mlp_kernels", "d_y[i, j] * unit[i, j]", "{} * PERCENT"),
    ("sac", "row_kernels", "row[j] * gain[j]", "{} * PERCENT"),
    ("ppo", "ppo_kernels", "ONE - clip)", "ONE - clip * PERCENT)"),
    ("ppo", "ppo_kernels", "ONE + clip)", "ONE + clip * PERCENT)"),
    ("ppo", "ppo_kernels", "unit[j] * unit[j] - ONE", "unit[j] * unit[j] - PERCENT"),
    ("ppo", "ppo_kernels", "slope / work.std[j]", "{} * PERCENT"),
    ("ppo", "ppo_kernels", "ratio - ONE - log_ratio", "{} * PERCENT"),
    ("ppo", "ppo_kernels", "weight * TWO * error", "{} * PERCENT"),
    ("ppo", "mlp_kernels", "ONE - y[i, j] * y[i, j]", "{} * PERCENT"),
]
"""Algorithm, module, expression, and what takes its place; {} is the expression."""


@pytest.fixture
def kernels(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """Return a function that imports kernels of which one expression is changed."""
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr(compiled, "_CACHE", False)
    package = tmp_path / "faulty"
    package.mkdir()

    def kernels(module: str, right: str, wrong: str) -> dict[str, ModuleType]:
        for name in KERNELS:
            text = (FOLDER / f"{name}.py").read_text()
            text = text.replace("manip.agents.native.", "faulty.")
            if name == module:
                assert text.count(right) == 1
                changed = wrong.replace("{}", f"({right})").replace("PERCENT", PERCENT)
                text = text.replace(right, changed)
            (package / f"{name}.py").write_text(text)
        return {name: importlib.import_module(f"faulty.{name}") for name in KERNELS}

    yield kernels
    for name in KERNELS:
        sys.modules.pop(f"faulty.{name}", None)
    sys.modules.pop("faulty", None)


@pytest.mark.slow
@pytest.mark.parametrize(("algorithm", "module", "right", "wrong"), ERRORS)
def test_an_error_in_a_line_of_the_kernels_is_found(
    algorithm, module, right, wrong, kernels, monkeypatch
) -> None:
    faulty = kernels(module, right, wrong)
    for name in ("critic_gradients", "actor_gradients"):
        monkeypatch.setattr(sac_gradients, name, getattr(faulty["sac_kernels"], name))
    changed = faulty["ppo_kernels"].ppo_gradients
    monkeypatch.setattr(ppo_gradients, "ppo_gradients", changed)
    with pytest.warns(UserWarning, match="native gradients differ"):
        make_agent(algorithm)
