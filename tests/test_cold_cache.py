"""A process that compiles computes the bits of a process that loads the cache."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

ALGORITHMS = (
    *("reinforce", "a2c", "a3c", "trpo", "ppo"),
    *("ppo-kl", "dqn", "td3", "sac", "bc"),
)
ROOT = Path(__file__).parent.parent

NORMALISE = """
import numpy as np
from manip.agents.native.row_kernels import normalise as layer_norm
from manip.compiled import fast_jit, fast_kernel

@fast_kernel
def normalise_twice(z, bias, gain, shift, deviation, y):
    layer_norm(z, bias, gain, shift, deviation, y)
    layer_norm(y, bias, gain, shift, deviation, z)

@fast_jit
def normalise(z, bias, gain, shift, deviation, y):
    normalise_twice(z, bias, gain, shift, deviation, y)
    normalise_twice(y, bias, gain, shift, deviation, z)

draw = np.random.default_rng(0)
shapes = [(50, 37), 37, 37, 37, 50, (50, 37)]
arrays = [draw.standard_normal(shape).astype(np.float32) for shape in shapes]
normalise(*arrays)
print(arrays[0].tobytes().hex())
"""
"""A kernel whose sums LLVM orders differently by itself and as a linked copy."""

GRADIENTS_AND_ENGINE = """
import numpy as np
import torch
from manip.agents.agent import Spaces
from manip.agents.ppo import PPO, PPOConfig
from manip.agents.sac import SAC, SACConfig
from manip.envs.make_batch import make_batch

torch.manual_seed(0)
sac, ppo = SAC(SACConfig(), Spaces(40, 7), 2), PPO(PPOConfig(), Spaces(40, 7), 2)
for agent in (sac, ppo)[::{order}]:
    torch.manual_seed(1)
    if agent is sac:
        rows = torch.randn(256, 90)
        rows[:, -2:] = torch.tensor([3.0, 0.0])
        loss, _ = sac._gradients.critic(rows), sac._gradients.actor(rows)
        gradients = [sac._params.critics.grad, sac._params.actor.grad]
    else:
        loss = ppo._gradients(torch.randn(256, 50)).loss_critic
        gradients = [ppo._params.grad]
    bits = b"".join(gradient.numpy().tobytes() for gradient in gradients)
    print(type(agent).__name__, loss.hex(), hash(bits))

batch, draw = make_batch("Lift", 4), np.random.default_rng(0)
batch.begin(np.arange(4))
for _ in range(20):
    step = batch.step(draw.uniform(-1, 1, (4, 7)))
print("engine", hash(step.observation.tobytes()))
"""


def run(cache: Path | str, *arguments: str) -> str:
    """Run Python in a process of its own and return what it prints."""
    command = [sys.executable, *arguments]
    settings = {"NUMBA_CACHE_DIR": str(cache), "PYTHONHASHSEED": "0"}
    settings["PYTHONPATH"] = str(ROOT)
    done = subprocess.run(
        command, env=os.environ | settings, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_cold_warm_and_unwritable_caches_give_equal_bits(tmp_path: Path) -> None:
    program = tmp_path / "normalise.py"
    program.write_text(NORMALISE)
    cold, warm = [run(tmp_path, str(program)) for _ in range(2)]
    assert list(tmp_path.rglob("*.nbc"))
    assert cold == warm
    assert run("/proc/unwritable", str(program)) == cold


@pytest.mark.slow
def test_gradients_and_engine_are_equal_in_cold_and_warm_processes(tmp_path) -> None:
    cold, warm, other_order = [
        run(tmp_path, "-c", GRADIENTS_AND_ENGINE.format(order=order))
        for order in (1, 1, -1)
    ]
    assert cold == warm
    assert sorted(other_order.splitlines()) == sorted(warm.splitlines())


@pytest.mark.slow
@pytest.mark.parametrize("algorithm", ALGORITHMS)
def test_a_run_is_equal_with_a_cold_and_a_warm_cache(algorithm: str, tmp_path) -> None:
    cache, weights = tmp_path / "cache", []
    for name in ("cold", "warm"):
        folder = tmp_path / name
        run(cache, "scripts/train.py", *options(algorithm), "--out", str(folder))
        (policy,) = (folder / "policy").glob("*.safetensors")
        weights.append(policy.read_bytes())
    assert weights[0] == weights[1]


def options(algorithm: str) -> list[str]:
    """Options of a run that updates the policy a few times."""
    sizes = {"steps": 2048, "eval-every": 2048, "eval-episodes": 2, "threads": 2}
    if algorithm in {"sac", "td3", "dqn"}:
        sizes["agent.random-steps"] = 512
    flags = [part for name, size in sizes.items() for part in (f"--{name}", str(size))]
    return ["--task", "Reach", "--algo", algorithm, *flags]
