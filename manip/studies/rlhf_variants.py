"""The runs that the study of preferences compares, and the figures they belong to.

Runs are shared: a variant that belongs to several figures is trained once.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal, get_args

from manip.preferences.label_options import Inputs, Labeller, LabelOptions
from manip.training.config import TrainConfig
from manip.training.recipes import recipe

Part = Literal["methods", "overoptimisation", "labels", "inputs", "labellers"]
"""A question of the study, and its figure."""

PARTS: tuple[Part, ...] = get_args(Part)

REFERENCE, TRUE, FULL = "reference", "true reward", "ppo-kl"
"""Names of the variants that most figures show: before, the upper bound, the method."""

LABELS = 300
"""Comparisons of a run, if not said otherwise."""

OUTSIDE = 500
"""Comparisons of the part `inputs`."""

COUNTS = (25, 100, 300, 500)
"""Numbers of comparisons that the part `labels` compares."""

FEW = 50
"""Comparisons of the part `overoptimisation`, all before the run."""

BETA = 0.01
"""Weight of the divergence from the reference, beside rewards of standard deviation
0.1."""

CLOSER = 0.1
"""A larger weight, for reward models that know less."""

BETAS = (0.0, CLOSER)
"""Weights that the part `overoptimisation` compares."""

STAGES = 3
"""Times that a run of the part `overoptimisation` is scored."""

ROUNDS = 5
"""Rounds of comparisons of a run that has them in rounds; a third in the first one."""

FLAWED: tuple[Labeller, ...] = ("mistake", "noisy", "skip", "myopic", "equal")
"""Simulated labellers besides the oracle."""

NUM_ENVS, HORIZON = 64, 100
"""Environments of a run, and length of their episodes [control steps]."""

ROLLOUT = 32
"""Control steps of each environment between two updates, as the algorithms have it."""

START = 8_192
"""Control steps of the reference from which the first clips are cut."""

PPO = {"critic_rollouts": 5, "entropy_coefficient": 0.0, "target_kl": 0.1}
"""Options of PPO-KL: fine-tuning needs a critic first, and no exploration bonus. The
spread of a reference is small, so that small changes of an action are many nats."""

RAW: Inputs = "observation+action"


@dataclass(frozen=True)
class Variant:
    """Runs that differ in their seed only.

    Attributes:
        name: of the variant.
        config: options of its runs, without seed, folders and reference.
        stages: control steps after which it is scored.
    """

    name: str
    config: TrainConfig
    stages: tuple[int, ...]

    @property
    def compares(self) -> bool:
        """Whether its runs learn from comparisons."""
        return bool(self.config.labels.taste)


@dataclass(frozen=True)
class Variants:
    """Builds the variants.

    Attributes:
        task: name of a task with a recipe for gaussian-bc.
        taste: name of the taste that simulated labellers have.
        steps: control steps of a run.
        reference_steps: control steps of a reference; those of its recipe unless given.
    """

    task: str
    taste: str
    steps: int
    reference_steps: int | None = None

    def of(self, parts: Sequence[Part]) -> dict[str, Variant]:
        """The variants of some parts, each once: name -> variant."""
        builders = {
            "methods": self._methods,
            "overoptimisation": self._overoptimisation,
            "labels": self._labels,
            "inputs": self._inputs,
            "labellers": self._labellers,
        }
        variants = [self.reference()]
        for part in parts:
            variants += builders[part]()
        return {variant.name: variant for variant in variants}

    def reference(self) -> Variant:
        """Clones of varied demonstrations."""
        config = recipe(self.task, "gaussian-bc")
        steps = self.reference_steps or config.steps
        config = replace(config, steps=steps, eval_every=steps, eval_episodes=1)
        return Variant(REFERENCE, config, (steps,))

    def _methods(self) -> Iterator[Variant]:
        yield self._true()
        rounds, first = self._rounds(LABELS), _first(LABELS)
        yield self._ppo(labels_name(LABELS, True), rounds)
        yield self._ppo(labels_name(LABELS, False), first)
        episodes, winners = ({"source": each} for each in ("episodes", "winners"))
        yield self._variant("clone episodes", "clone-best", episodes, rounds)
        yield self._once("dpo, first", "dpo", {}, first)
        yield self._once("clone winners, first", "clone-best", winners, first)

    def _overoptimisation(self) -> Iterator[Variant]:
        for beta in BETAS:
            few = _first(FEW, inputs=RAW)
            yield self._ppo(few_name(beta), few, beta, STAGES)
        yield self._ppo(labels_name(LABELS, True), self._rounds(LABELS))

    def _labels(self) -> Iterator[Variant]:
        for count in COUNTS:
            yield self._ppo(labels_name(count, True), self._rounds(count))
            yield self._ppo(labels_name(count, False), _first(count))
        yield self._true()

    def _inputs(self) -> Iterator[Variant]:
        yield self._true()
        yield self._ppo(labels_name(LABELS, True), self._rounds(LABELS))
        for beta in (BETA, CLOSER):
            labels = self._rounds(OUTSIDE, inputs=RAW)
            yield self._ppo(raw_name(beta), labels, beta)

    def _labellers(self) -> Iterator[Variant]:
        yield self._true()
        yield self._ppo(FULL, self._rounds(LABELS))
        for labeller in FLAWED:
            labels = self._rounds(LABELS, labeller=labeller)
            yield self._ppo(f"{FULL}, {labeller}", labels)

    def _true(self) -> Variant:
        """The taste itself as the reward, without a penalty: an upper bound."""
        config = self._config("ppo-kl", PPO | {"reference_beta": 0.0})
        return Variant(TRUE, replace(config, taste=self.taste), (self.steps,))

    def _ppo(
        self, name: str, labels: LabelOptions, beta: float = BETA, stages: int = 1
    ) -> Variant:
        agent = PPO | {"reference_beta": beta}
        return self._variant(name, "ppo-kl", agent, labels, stages)

    def _variant(
        self,
        name: str,
        algo: str,
        agent: Mapping[str, Any],
        labels: LabelOptions,
        stages: int = 1,
    ) -> Variant:
        labels = replace(labels, taste=self.taste)
        config = replace(self._config(algo, agent), labels=labels)
        ends = (self.steps * (k + 1) // stages for k in range(stages))
        return Variant(name, config, tuple(ends))

    def _once(
        self, name: str, algo: str, agent: Mapping[str, Any], labels: LabelOptions
    ) -> Variant:
        """A variant that ends after its only round: it learns nothing afterwards."""
        variant = self._variant(name, algo, agent, labels)
        return replace(variant, stages=(START + NUM_ENVS * ROLLOUT,))

    def _config(self, algo: str, agent: Mapping[str, Any]) -> TrainConfig:
        config = recipe(self.task, algo)
        return replace(
            config,
            steps=self.steps,
            num_envs=NUM_ENVS,
            horizon=HORIZON,
            cool_down=0.0,
            eval_every=self.steps,
            eval_episodes=1,
            agent=replace(config.agent, **agent),
        )

    def _rounds(self, total: int, **options: Any) -> LabelOptions:
        """Comparisons in rounds, evenly spread over the run."""
        first = -(-total // 3)
        return _labels(
            total=total,
            first=first,
            per_round=-(-(total - first) // (ROUNDS - 1)),
            every=(self.steps - START) // ROUNDS,
            **options,
        )


def _first(total: int, **options: Any) -> LabelOptions:
    """All comparisons before the policy learns."""
    return _labels(total=total, first=total, **options)


def _labels(**options: Any) -> LabelOptions:
    return LabelOptions(**{"labeller": "oracle", "start": START, **options})


def labels_name(count: int, in_rounds: bool) -> str:
    """Name of PPO-KL with a number of comparisons."""
    name = FULL if count == LABELS else f"{FULL}, {count}"
    return name if in_rounds else f"{name}, first"


def few_name(beta: float) -> str:
    """Name of PPO-KL with few comparisons of raw inputs."""
    return f"{FULL}, {FEW} raw, beta {beta:g}"


def raw_name(beta: float) -> str:
    """Name of PPO-KL whose reward model sees observation and action."""
    name = f"{FULL}, {OUTSIDE} raw"
    return name if beta == BETA else f"{name}, beta {beta:g}"
