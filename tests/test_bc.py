"""Behaviour cloning: the loss by hand, how the expert is disturbed, and learning."""

from dataclasses import replace
from pathlib import Path

import pytest
import torch
from tensordict import TensorDict
from tiny import Tiny
from torch import Tensor
from torchrl.envs import check_env_specs

from manip.agents.actor_inputs import ActorInputs
from manip.agents.agent import Spaces
from manip.agents.bc import BC, BCConfig
from manip.agents.demonstration import Demonstration
from manip.envs.adapters.torchrl import TaskEnv
from manip.envs.backends.native_batch import NativeBatch
from manip.envs.task import Task
from manip.envs.task_registry import load_task
from manip.errors import UserError
from manip.sim.scene import Scene
from manip.training.build import training_envs
from manip.training.config import from_dict

SPACES = Spaces(observation_dim=1, action_dim=2)
QUICK = BCConfig(actor_hidden=(32,), batch_size=32, learning_rate=3e-3)


def labelled(rows: int, seed: int = 0) -> TensorDict:
    """Steps [1, rows] of an expert that grips while it moves towards x = 0."""
    x = torch.rand(1, rows, 1, generator=torch.Generator().manual_seed(seed)) * 2 - 1
    return TensorDict({"observation": x, "expert_action": expert(x)}, (1, rows))


def expert(x: Tensor) -> Tensor:
    return torch.cat([(-3 * x).clamp(-1, 1), (x.abs() > 0.5) * 2.0 - 1], -1)


def agent_of(config: BCConfig = QUICK) -> BC:
    torch.manual_seed(0)
    return BC(config, SPACES)


def test_the_loss_is_the_distance_of_the_actions() -> None:
    agent = agent_of(replace(QUICK, batch_size=256, updates_per_step=1 / 256))
    batch = labelled(256)
    with torch.no_grad():
        drawn = agent.actor.decide(batch["observation"]) - batch["expert_action"]
    loss = agent.update(batch)["loss_actor"]
    assert loss == pytest.approx(drawn.abs().mean().item(), rel=0.1)  # with repeats


def test_updates_follow_the_steps() -> None:
    agent = agent_of(replace(QUICK, updates_per_step=0.125))
    counts = [bool(agent.update(labelled(6))) for _ in range(4)]
    assert counts == [False, True, True, True]
    assert agent.optimisers()["actor"].state_dict()["state"][0]["step"] == 3


def test_it_learns_the_expert() -> None:
    agent = agent_of()
    for seed in range(8):
        agent.update(labelled(128, seed))
    x = torch.linspace(-0.95, 0.95, 39)[:, None]
    clear = ((x.abs() - 0.5).abs() > 0.1).squeeze(-1)
    missed = (agent.actor.decide(x) - expert(x)).abs()[clear]
    assert missed.mean() < 0.05


# Noise


def disturbed(noise: float, lasting: int, steps: int) -> Tensor:
    """[steps, 5, 2]: actions of five environments whose expert rests."""
    policy = Demonstration(agent_of().actor, ActorInputs(), noise, lasting, 0.0)
    rest = TensorDict(
        {"observation": torch.ones(5, 1), "expert_action": torch.zeros(5, 2)}, 5
    )
    return torch.stack([policy(rest.clone())["action"] for _ in range(steps)])


def test_noise_grows_from_none_in_the_first_environment() -> None:
    spread = disturbed(0.2, 1, 4_000).std(0)[:, 0]
    expected = torch.tensor([0.0, 0.05, 0.1, 0.15, 0.2])
    torch.testing.assert_close(spread, expected, atol=0.01, rtol=0)


def test_noise_lasts_noise_steps_on_average() -> None:
    moves = disturbed(0.2, 10, 4_000)[:, 1:]
    renewed = (moves.diff(dim=0) != 0).double().mean()
    assert renewed.item() == pytest.approx(0.1, rel=0.1)


def test_disturbed_actions_stay_in_range() -> None:
    assert disturbed(5.0, 2, 200).abs().max() == 1.0


def test_the_clone_acts_in_the_last_environments_once_it_has_learned() -> None:
    agent = agent_of(replace(QUICK, noise=0.0, clones=0.4))
    now = labelled(5).squeeze(0)
    assert torch.equal(agent.policy()(now.clone())["action"], now["expert_action"])
    agent.update(labelled(64))
    action, own = agent.policy()(now.clone())["action"], agent.actor.decide
    assert torch.equal(action[:3], now["expert_action"][:3])
    assert torch.equal(action[3:], own(now["observation"][3:]))


# Actions of the expert


def test_environments_give_the_experts_action(lift: Task, lift_scene: Scene) -> None:
    env = TaskEnv(NativeBatch(lift, 3, scene=lift_scene, threads=1), expert=True)
    check_env_specs(env)
    state = env.reset()
    for _ in range(3):
        measures = lift.measure(env.batch.engine.read())
        expected = torch.from_numpy(lift.expert(measures)).float()
        assert torch.equal(state["expert_action"], expected)
        state["action"] = state["expert_action"]
        _, state = env.step_and_maybe_reset(state)


def test_a_task_without_an_expert_is_refused(scene_of) -> None:
    env = TaskEnv(
        NativeBatch(Tiny(), 2, scene=scene_of(Tiny()), threads=1), expert=True
    )
    with pytest.raises(UserError, match=r"'Tiny' has no expert .* another algorithm"):
        env.reset()


def test_experts_act_in_one_action_space_only(tmp_path: Path) -> None:
    options = {"algo": "bc", "controller": "JOINT_POSITION", "out": str(tmp_path)}
    with pytest.raises(UserError, match="OSC_POSE actions, not JOINT_POSITION"):
        training_envs(from_dict(options))


def test_an_expert_grasps_again_after_it_has_missed(
    lift: Task, lift_scene: Scene
) -> None:
    """The gripper is closed before the hand reaches the cube: it must open again."""
    env = TaskEnv(NativeBatch(lift, 4, scene=lift_scene, threads=1), expert=True)
    state = env.reset()
    for step in range(60):
        action = state["expert_action"].clone()
        action[:, -1] = torch.where(torch.tensor(step < 12), 1.0, action[:, -1])
        state = env.step(state.set("action", action))["next"]
    assert state["success"].all()


def test_the_expert_of_stack_recovers_from_action_noise(scene_of) -> None:
    stack = load_task("Stack")
    batch = NativeBatch(stack, 16, scene=scene_of(stack), threads=2)
    env = TaskEnv(batch, expert=True)
    state, random = env.reset(), torch.Generator().manual_seed(0)
    for _ in range(95):
        action = state["expert_action"]
        noise = 0.1 * torch.randn(action.shape, generator=random)
        state = env.step(state.set("action", (action + noise).clamp(-1, 1)))["next"]
    assert state["success"].float().mean() > 0.9
