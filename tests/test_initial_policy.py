"""--init: the initial actor acts as the given policy, warm-up, errors, resume."""

import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import torch
from toy import QUICK_PPO, QUICK_SAC, QUICK_TD3, QUICK_TRPO, make_agent, rollout_of
from training_runs import (
    assert_equal_runs,
    finished,
    new_trainer,
    stop_after,
    tiny,
)

from manip.agents.agent import Agent
from manip.agents.image_actor import ImageActor
from manip.agents.image_encoder import EncoderSizes
from manip.agents.initial_actor import initial_actor, network_options
from manip.agents.networks import Actor
from manip.agents.policy import Policy, load_policy
from manip.errors import UserError
from manip.observation import ObservationPart, ObservationSpec
from manip.training.config import from_dict
from manip.training.initial_policy import CAREFUL, starting_from
from manip.training.recipes import recipe
from manip.training.trainer import Trainer


def starting(algo: str, given: str, out: Path, **changes: Any) -> Trainer:
    """A small run of `algo` that starts from the finished run of `given`."""
    config = tiny(algo, out, **changes)
    where = str(finished(given).config.folder)
    agent = starting_from(config, where).agent
    return new_trainer(replace(config, init=where, agent=agent))


def states(count: int = 64) -> torch.Tensor:
    width = load_policy(finished("bc").config.folder).card.observation_dim
    return torch.randn(count, width, generator=torch.Generator().manual_seed(0))


@pytest.mark.parametrize(
    ("algo", "given"),
    [
        *(("sac", "bc"), ("td3", "bc"), ("ppo", "bc"), ("trpo", "bc")),
        *(
            pytest.param(*pair, marks=pytest.mark.slow)
            for pair in (("sac", "sac"), ("bc", "sac"), ("ppo", "ppo"), ("a2c", "ppo"))
        ),
    ],
)
def test_the_initial_actor_acts_as_the_policy(algo: str, given: str, tmp_path) -> None:
    trainer = starting(algo, given, tmp_path / "run")
    policy = load_policy(finished(given).config.folder)
    actor = trainer.parts.agent.actor
    assert torch.equal(actor.decide(states()), policy.actor.decide(states()))
    assert "layers loaded; new: the critics" in trainer.parts.notes[0]


@pytest.mark.parametrize(("algo", "given"), [("sac", "bc"), ("ppo", "bc")])
def test_actions_deviate_as_requested(algo: str, given: str, tmp_path) -> None:
    trainer = starting(algo, given, tmp_path / "run", init_std=0.05)
    agent: Any = trainer.parts.agent
    _, scale = (agent.explorer if algo == "sac" else agent.gaussian)(states())
    torch.testing.assert_close(scale, torch.full_like(scale, 0.05))


def test_target_networks_start_from_the_policy_as_well(tmp_path: Path) -> None:
    loss: Any = starting("td3", "bc", tmp_path / "run").parts.agent.modules()["loss"]
    learned, target = loss.actor_network_params, loss.target_actor_network_params
    pairs = zip(learned.values(True, True), target.values(True, True), strict=True)
    assert all(torch.equal(left, right) for left, right in pairs)


def spec_of(*names: str) -> ObservationSpec:
    return ObservationSpec(
        tuple(ObservationPart(name, (2,), "float32", "object") for name in names)
    )


@pytest.mark.parametrize("normalise", [False, True])
def test_inputs_are_matched_by_name_and_unknown_ones_have_no_effect(normalise) -> None:
    """The old network reads a, b; the new one reads c, b, a: c counts for nothing."""
    torch.manual_seed(0)
    old = Actor(4, 3, (8,), squash=True, normalise=normalise)
    if normalise:
        old.norm.update(torch.randn(50, 4) * 3 + 1)
    card = replace(
        load_policy(finished("bc").config.folder).card,
        observation=spec_of("a", "b").to_dict(),
    )
    new = Actor(6, 3, (8,), squash=True, normalise=normalise)
    initial = initial_actor(Policy(card, old), new, spec_of("c", "b", "a"), "x")
    new.load_state_dict(initial.weights)
    assert initial.new == ["c"]
    a, b, c = torch.randn(3, 5, 2)
    new_inputs, old_inputs = torch.cat([c, b, a], 1), torch.cat([a, b], 1)
    torch.testing.assert_close(new.decide(new_inputs), old.decide(old_inputs))


def camera(name: str) -> ObservationPart:
    return ObservationPart(f"{name}_image", (8, 8, 3), "uint8", "camera")


def image_actor(vector_dim: int, cameras: int) -> ImageActor:
    sizes = EncoderSizes(((8, 8, 3),) * cameras, (4,), 5)
    return ImageActor(sizes, vector_dim, 3, (8,), squash=True, normalise=False)


def test_encoders_are_matched_by_their_cameras() -> None:
    """The old network sees a, left, right; the new one b, a, right, top, left."""
    torch.manual_seed(0)
    card = load_policy(finished("bc").config.folder).card
    spec = ObservationSpec((*spec_of("a").parts, camera("left"), camera("right")))
    old = image_actor(2, cameras=2)
    policy = Policy(replace(card, observation=spec.to_dict()), old)
    views = camera("right"), camera("top"), camera("left")
    new = image_actor(4, cameras=3)
    spec = ObservationSpec((*spec_of("b", "a").parts, *views))
    initial = initial_actor(policy, new, spec, "x")
    new.load_state_dict(initial.weights)
    assert initial.new == ["b", "top_image"]
    a, b = torch.randn(2, 5, 2)
    left, right, top = torch.randint(256, (3, 5, 8, 8, 3), dtype=torch.uint8)
    torch.testing.assert_close(
        new.decide(torch.cat([b, a], 1), right, top, left), old.decide(a, left, right)
    )


def student(*parts: ObservationPart) -> Policy:
    """A policy that sees the part a, besides others, and one camera."""
    spec = ObservationSpec((*spec_of("a").parts, *parts))
    card = load_policy(finished("bc").config.folder).card
    actor = image_actor(spec.dim, cameras=1)
    return Policy(replace(card, observation=spec.to_dict()), actor)


def test_parts_that_only_the_policy_sees_are_named() -> None:
    policy = student(*spec_of("goal").parts, camera("left"))
    spec = ObservationSpec((*spec_of("a").parts, camera("left")))
    initial = initial_actor(policy, image_actor(2, 1), spec, "x")
    assert (initial.new, initial.unused) == ([], ["goal"])


def test_a_policy_that_sees_images_of_another_size_is_refused() -> None:
    large = ObservationPart("left_image", (16, 16, 3), "uint8", "camera")
    spec = ObservationSpec((*spec_of("a").parts, camera("left")))
    with pytest.raises(UserError, match=r"of shape \[16, 16, 3\], not \[8, "):
        initial_actor(student(large), image_actor(2, 1), spec, "x")


def test_an_actor_that_sees_cameras_does_not_start_from_one_that_does_not() -> None:
    policy = load_policy(finished("bc").config.folder)
    with pytest.raises(UserError, match="in x sees the state: it starts an actor that"):
        initial_actor(policy, image_actor(2, 1), spec_of("a"), "x")


def test_a_policy_that_knows_no_part_is_refused(tmp_path: Path) -> None:
    policy = load_policy(finished("bc").config.folder)
    new = Actor(2, 7, (16,), squash=True, normalise=False)
    with pytest.raises(UserError, match=r"sees none of the parts .*: z"):
        initial_actor(policy, new, spec_of("z"), "x")


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"agent": {"actor_hidden": [8]}}, r"actor_hidden is \(8,\), not \(16,\)"),
        ({"agent": {"action_scale": [0.5] * 7}}, r"action_scale is \(0.5, .* not \(\)"),
        ({"control_freq": 10}, "control_freq 20, not 10: its actions mean something"),
        ({"controller": "OSC_POSITION"}, "controller OSC_POSE, not OSC_POSITION"),
        ({"init": "no/such"}, "no/such holds no policy"),
        ({"algo": "ppo", "agent": {}}, "squash is False, not True"),
        ({"algo": "dqn", "agent": {}}, "dqn has no actor that could start"),
    ],
)
def test_a_policy_that_does_not_fit_is_refused(changes, message, tmp_path) -> None:
    options = {"algo": "sac", "init": str(finished("bc").config.folder)} | changes
    with pytest.raises(UserError, match=message):
        new_trainer(tiny(options.pop("algo"), tmp_path / "run", **options))


def test_the_options_of_the_network_and_a_careful_start_come_with_it() -> None:
    config = starting_from(recipe("Lift", "sac"), "Lift")
    policy = load_policy("Lift")
    assert config.init == "Lift"
    for name in ("actor_hidden", "action_scale"):
        assert getattr(config.agent, name) == network_options(policy.actor)[name]
    for name in ("random_steps", "critic_steps", "initial_alpha"):
        assert getattr(config.agent, name) == CAREFUL[name]
    assert from_dict({"init": "Lift"}).init == "Lift"


def test_another_task_takes_the_network_only() -> None:
    own = recipe("Stack", "sac")
    config = starting_from(own, "Lift")
    taken = network_options(load_policy("Lift").actor)
    changed = {k: v for k, v in taken.items() if hasattr(own.agent, k)}
    assert config == replace(own, init="Lift", agent=replace(own.agent, **changed))


def copies(agent: Agent) -> dict[str, torch.Tensor]:
    return {
        f"{name}.{key}": value.clone()
        for name, module in agent.modules().items()
        for key, value in module.state_dict().items()
        if "norm" not in key
    }


@pytest.mark.parametrize(
    "config",
    [
        replace(QUICK_SAC, random_steps=32, critic_steps=80),
        replace(QUICK_TD3, random_steps=32, critic_steps=80),
        replace(QUICK_PPO, critic_rollouts=2),
        replace(QUICK_TRPO, critic_rollouts=2),
        replace(QUICK_PPO, critic_rollouts=2, squash=True),
    ],
)
def test_only_the_critics_learn_at_first(config: Any) -> None:
    """The rollouts have 48 steps: the actor learns from the third one on."""
    agent = make_agent(config, seed=0)
    for warming_up in (True, True, False):
        before = copies(agent)
        agent.update(rollout_of(agent))
        moved = {k for k, v in copies(agent).items() if not torch.equal(v, before[k])}
        assert any("qvalue" in name or "critic" in name for name in moved)
        assert warming_up != any("actor" in name for name in moved)


@pytest.mark.parametrize(
    ("algo", "given"),
    [("sac", "bc"), pytest.param("ppo", "bc", marks=pytest.mark.slow)],
)
def test_a_run_resumes_exactly_without_its_initial_policy(
    algo: str, given: str, tmp_path: Path
) -> None:
    where = tmp_path / "policy"
    shutil.copytree(finished(given).config.folder / "policy", where)
    runs = []
    for name in ("whole", "parts"):
        config = tiny(algo, tmp_path / name / "run")
        agent = starting_from(config, str(where)).agent
        runs.append(replace(config, init=str(where), agent=agent))
    assert new_trainer(runs[0]).run()
    trainer = new_trainer(runs[1])
    stop_after(trainer, 3)
    assert not trainer.run()
    shutil.rmtree(where)
    assert new_trainer(replace(runs[1], resume=True)).run()
    assert_equal_runs(*(config.folder for config in runs))
