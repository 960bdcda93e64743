"""Build what a run with `--preferences` needs: clips, rounds, the learned reward."""

import hashlib
import json
from collections.abc import Sequence

from manip.agents.agent import Agent
from manip.agents.registry import load_algorithm
from manip.envs.adapters.torchrl import TaskEnv
from manip.envs.external_task import ExternalTask
from manip.envs.task_batch import TaskBatch
from manip.envs.task_registry import load_task
from manip.errors import UserError
from manip.io.output_paths import check_output_folder
from manip.preferences.clip_pool import ClipPool
from manip.preferences.clip_source import ClipSource, not_recordable
from manip.preferences.label_folder import LabelFolder
from manip.preferences.label_options import LabelOptions
from manip.preferences.label_rounds import Labeller, Rounds
from manip.preferences.labellers import TasteCriterion, make_labeller
from manip.preferences.preference_agent import PreferenceAgent
from manip.preferences.reward_learning import generator_of
from manip.preferences.reward_model import HIDDEN, RewardCard, RewardModel, input_names
from manip.preferences.reward_network import RewardNetwork
from manip.preferences.taste_reward import TasteReward
from manip.preferences.tastes import load_taste
from manip.rewards.reward_function import RewardFunction, WeightedTerms
from manip.training.config import TrainConfig, lasting, lasting_defaults


def check_preferences(config: TrainConfig) -> None:
    """Check that an algorithm and `--preferences` fit each other.

    Raises:
        UserError: they do not.
    """
    algorithm = load_algorithm(config.algo)
    if config.taste and config.preferences is not None:
        raise UserError(
            "--taste is paid as a reward, and --preferences learns one: leave one of "
            "them out, or give the taste to the labeller with --labels.taste"
        )
    if config.preferences is None:
        if algorithm.needs_preferences:
            raise UserError(
                f"{config.algo} learns from compared clips: give a folder for them "
                "with --preferences"
            )
        if config.labels != LabelOptions():
            raise UserError(
                "--labels has no effect without --preferences: name a folder for the "
                "comparisons with --preferences, or leave out --labels"
            )
        return
    check_output_folder(config.preferences, "--preferences")
    if isinstance(load_task(config.task), ExternalTask):
        raise not_recordable(config.task)
    if getattr(config.agent, "reference", "") is None and algorithm.needs_preferences:
        raise UserError(
            f"{config.algo} changes a policy that was trained before: name it with "
            "--agent.reference"
        )
    if algorithm.imitates:
        raise UserError(
            f"{config.algo} learns from actions, not from a reward: --preferences has "
            "no use; choose ppo-kl or pebble"
        )
    if algorithm.process_rollout is not Agent.process_rollout:
        raise UserError(
            f"{config.algo} learns while it collects, before a learned reward is "
            "there: choose ppo-kl or pebble for --preferences"
        )


def with_preferences(config: TrainConfig, agent: Agent, env: TaskEnv) -> Agent:
    """The agent of a run: itself, or inside one that learns a reward for it.

    Args:
        env: the run's training environments.

    Raises:
        UserError: the task's states cannot be recorded, there is no such taste, or the
            folder holds answers to clips of other runs' tasks, arms or lengths.
    """
    if config.preferences is None:
        return agent
    options, batch = config.labels, env.batch
    source = ClipSource.of(batch, config.task)
    capacity = max(options.recent // options.clip_steps, batch.num_envs)
    example = env.fake_tensordict().unsqueeze(1)
    rounds = Rounds(
        options=options,
        folder=LabelFolder(config.preferences, run_id(config)),
        source=source,
        labeller=_labeller(config, batch.measure_names),
        model=_untrained(config, env),
        task=WeightedTerms([*batch.reward_weights.values()]),
        seed=config.seed,
    )
    rounds.check()
    pool = ClipPool(example, options.clip_steps, capacity, source.nq)
    return PreferenceAgent(agent, pool, rounds)


def with_taste(
    config: TrainConfig, reward: RewardFunction, batch: TaskBatch
) -> RewardFunction:
    """The reward of a run: minus the penalties of its taste, if it has one.

    Raises:
        UserError: there is no such taste.
    """
    if not config.taste:
        return reward
    taste = load_taste(config.task, config.taste)
    return TasteReward(reward, taste, batch.measure_names)


def run_id(config: TrainConfig) -> str:
    """12 hexadecimal digits that identify runs of the same options.

    Defaults are left out: an option that is new in manip changes no run's identity.
    """
    defaults = lasting_defaults(config.algo)
    chosen = {n: v for n, v in lasting(config).items() if v != defaults[n]}
    text = json.dumps(chosen | {"algo": config.algo}, sort_keys=True, default=str)
    return hashlib.sha256(text.encode()).hexdigest()[:12]


def _labeller(config: TrainConfig, measures: Sequence[str]) -> Labeller | None:
    options = config.labels
    if options.labeller == "people":
        return None
    taste = load_taste(config.task, options.taste) if options.taste else None
    if taste:
        taste.check(measures)
    criterion = TasteCriterion(taste)
    return make_labeller(options.labeller, criterion, options.seed, options.mistakes)


def _untrained(config: TrainConfig, env: TaskEnv) -> RewardModel:
    options, batch = config.labels, env.batch
    card = RewardCard(
        task=config.task,
        robot=config.robot,
        inputs=options.inputs,
        names=input_names(
            options.inputs,
            batch.measure_names,
            batch.observation_spec.dim,
            batch.action_dim,
        ),
        hidden=HIDDEN,
        members=options.members,
        clip_steps=options.clip_steps,
    )
    generator = generator_of(config.seed)
    network = RewardNetwork(len(card.names), card.members, card.hidden, generator)
    return RewardModel(card, network)
