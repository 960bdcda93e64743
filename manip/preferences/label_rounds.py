"""Rounds of labels: have clips compared, and learn a reward from the answers."""

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import torch
from tensordict import TensorDictBase

from manip.agents.compared_clips import ComparedClips
from manip.errors import UserError
from manip.preferences.clip_pool import ClipPool, clip_of
from manip.preferences.clip_source import ClipSource
from manip.preferences.clips import Clip, load_clip, save_clip
from manip.preferences.comparison_record import Answer
from manip.preferences.label_folder import LabelFolder
from manip.preferences.label_options import LabelOptions
from manip.preferences.queries import Pairs, choose_pairs
from manip.preferences.reward_learning import ClipReader, generator_of, learn_reward
from manip.preferences.reward_model import FILE, RewardModel, clip_inputs
from manip.rewards.reward_function import RewardFunction

Labeller = Callable[[Clip, Clip], Answer]
"""Says which of a left and a right clip is better."""


@dataclass
class Rounds:
    """The rounds of a run.

    Attributes:
        options: when and how clips are compared.
        folder: the run's pairs and answers.
        source: what all clips of the run have in common.
        labeller: answers at once; None leaves the pairs to people.
        model: the present reward; before the first round its network is untrained.
        task: the task's own reward.
        seed: of the choice of pairs and the fits.
        labels: answers that the present reward was learned from.
    """

    options: LabelOptions
    folder: LabelFolder
    source: ClipSource
    labeller: Labeller | None
    model: RewardModel
    task: RewardFunction
    seed: int
    labels: int = 0
    _reader: ClipReader = field(init=False)

    def __post_init__(self) -> None:
        robot, widths = self.source.header.robot_config, self.source.widths
        self._reader = ClipReader(self.folder.folder, self.model.card, robot, widths)

    def reward(self, rollout: TensorDictBase) -> torch.Tensor:
        """Rewards [N, T, 1]: the learned ones, plus the weighted ones of the task."""
        learned = self.model(rollout)
        weight = self.options.task_reward
        return learned + weight * self.task(rollout) if weight else learned

    def check(self) -> None:
        """Read the clips of the answers that the folder holds already.

        Raises:
            UserError: one is of another task, arm, length or other measures.
            DamagedError: a file of the folder is damaged.
        """
        self.folder.check()
        self._reader.read(self.folder.present())

    def due(self, number: int, steps: int) -> bool:
        """Whether it is time for round `number`, after `steps` control steps."""
        options = self.options
        enough = number > 0 and self.labels >= options.total
        more = number < options.rounds and not enough
        return more and steps >= options.start + number * options.every

    def missing(self, number: int, pool: ClipPool) -> int:
        """Number of answers that a round still waits for.

        Asks for the round's pairs, and has a simulated labeller answer them.

        Raises:
            UserError: there are too few clips to choose from.
        """
        if not self.folder.pairs(number):
            self._ask(number, pool)
        if self.labeller:
            for pair in self.folder.unanswered(number):
                clips = [self._load(clip_id) for clip_id in (pair.left, pair.right)]
                self.folder.answer(pair, self.labeller(*clips), self.options.labeller)
        return len(self.folder.unanswered(number))

    def learn(self, number: int) -> ComparedClips:
        """Fit the reward to all answers, and save it to the folder.

        Returns:
            The compared clips, whose steps are observation and action.

        Raises:
            UserError: no clip was preferred to another one.
        """
        answers = self.folder.answers(number)
        pairs = self._reader.compared(answers, self.model.card.inputs)
        standard = self._standard() if self.options.scale == "standard" else None
        model = learn_reward(self.model.card, pairs, (self.seed, number), standard)
        self.model.network.load_state_dict(model.network.state_dict())
        self.model = replace(model, network=self.model.network)
        self.model.save(self.folder.folder / FILE)
        self.labels = len(answers)
        return self._reader.compared(answers, "observation+action")

    def _standard(self) -> torch.Tensor:
        """[C, L, F]: the clips of the first round's answers."""
        answers = self.folder.answers(0)
        first = self._reader.compared(answers, self.model.card.inputs)
        return torch.cat([first.left, first.right])

    def _load(self, clip_id: str) -> Clip:
        return load_clip(self.folder.folder, clip_id)

    def _ask(self, number: int, pool: ClipPool) -> None:
        count = self.options.wanted(number) - self.folder.count()
        if count <= 0:
            return
        clips = pool.clips
        if len(clips) < 2:
            raise UserError(
                f"there are only {len(clips)} clips to compare: raise --labels.start "
                "or --labels.every, or lower --labels.clip-steps"
            )
        pairs = self._choose(number, count, clips)
        ids = {row: self._save(clips[row], number) for row in pairs.unique().tolist()}
        self.folder.ask(number, [(ids[a], ids[b]) for a, b in pairs.tolist()])

    def _choose(self, number: int, count: int, clips: TensorDictBase) -> Pairs:
        options = self.options
        trained = number > 0 and options.choose == "disagreement"
        return choose_pairs(
            count,
            clip_inputs(clips, self.model.card.inputs),
            generator_of(self.seed, number),
            self.model.network if trained else None,
            options.candidates,
        )

    def _save(self, clip: TensorDictBase, number: int) -> str:
        """Write a clip of the pool to its file; return its id."""
        actor = f"{self.model.card.task} run, round {number}"
        return save_clip(self.folder.folder, clip_of(clip, self.source, actor))
