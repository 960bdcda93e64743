"""Options of a run that learns from preferences: who compares what, when, how often."""

from dataclasses import dataclass
from typing import Annotated, Literal

from manip.errors import UserError
from manip.io.option_ranges import COUNT, NUMBER, SHARE, WHOLE, Range, check_options

Inputs = Literal["measures", "observation+action"]
"""What the reward model sees of a step: the task's visible measures after it, or the
observation before it and the action."""

Labeller = Literal["people", "oracle", "mistake", "noisy", "skip", "myopic", "equal"]
"""Who compares clips: people, or one of the simulated labellers of B-Pref."""


@dataclass(frozen=True)
class LabelOptions:
    """Options `--labels.*` of a run with `--preferences`."""

    labeller: Labeller = "people"
    """Who compares the clips. people: the run saves and ends whenever pairs wait for
    `manip label`; all others are simulated (see docs/rlhf.md)."""
    taste: str = ""
    """Taste by which a simulated labeller compares, besides the task's reward (see
    `manip list`): the task's reward alone unless given."""
    mistakes: Annotated[float, SHARE] = 0.1
    """Fraction of wrong answers of the labeller `mistake`."""
    total: Annotated[int, COUNT] = 300
    """Comparisons to collect, those that the folder holds already included."""
    first: Annotated[int, COUNT] = 100
    """Comparisons in the first round; the reward is unknown until it is answered."""
    per_round: Annotated[int, COUNT] = 50
    """Comparisons in each later round."""
    start: Annotated[int, COUNT] = 8_192
    """Control steps before the first round, whose clips are of the first policy."""
    every: Annotated[int, COUNT] = 20_000
    """Control steps between rounds."""
    recent: Annotated[int, COUNT] = 20_000
    """Control steps from which a round takes its clips, the latest ones."""
    clip_steps: Annotated[int, Range(2, 1000)] = 20
    """Length of a clip [control steps]."""
    choose: Literal["disagreement", "uniform"] = "disagreement"
    """How pairs are chosen. disagreement: those on which the ensemble's members differ
    most; uniform: at random."""
    candidates: Annotated[int, COUNT] = 10
    """Random pairs for each one that is chosen by disagreement."""
    inputs: Inputs = "measures"
    """What the reward model sees of a step: the task's visible measures, or observation
    and action."""
    members: Annotated[int, Range(1, 100)] = 3
    """Networks in the reward model's ensemble."""
    scale: Literal["standard", "unit"] = "standard"
    """Scale of the learned reward. standard: mean 0 and standard deviation 0.1 over the
    clips of the first round; unit: from 0 to 1."""
    task_reward: Annotated[float, NUMBER] = 0.0
    """Weight of the task's own reward, which is added to the learned one. 0: the task
    is known from the answers alone. More where a clip is too short to show what the
    task needs; a step of the task pays up to 1."""
    seed: Annotated[int, WHOLE] = 0
    """Seed of a simulated labeller."""

    def __post_init__(self) -> None:
        check_options(self)
        if self.recent < 2 * self.clip_steps:
            raise UserError(
                f"labels.recent {self.recent} holds no two clips of {self.clip_steps} "
                "steps: raise it, or lower labels.clip_steps"
            )

    @property
    def rounds(self) -> int:
        """Number of rounds, if the folder holds no comparisons before."""
        return 1 + max(0, -(-(self.total - self.first) // self.per_round))

    def wanted(self, number: int) -> int:
        """Comparisons that there should be after round `number`, from 0."""
        return min(self.first + number * self.per_round, self.total)
