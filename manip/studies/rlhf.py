"""Study of learning from preferences: train the variants, and score each policy."""

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

from manip.cluster.executors import finish_runs
from manip.errors import UserError, one_line
from manip.io.atomic_files import write_text
from manip.io.dataclass_values import build
from manip.studies.rlhf_scores import PolicyScore, Scorer
from manip.studies.rlhf_variants import REFERENCE, Variant
from manip.training.config import TrainConfig


@dataclass(frozen=True)
class PreferenceRun:
    """A run of the study, up to the end of a stage.

    Attributes:
        task, taste: what it was trained for.
        variant, seed, env_steps: of the run.
        labels: comparisons that it was to learn from; 0 without any.
    """

    task: str
    taste: str
    variant: str
    seed: int
    env_steps: int
    labels: int


@dataclass(frozen=True)
class PreferenceRow(PolicyScore, PreferenceRun):
    """The score of a run's policy: the run's columns, then the score's."""


@dataclass(frozen=True)
class PreferenceStudy:
    """Runs with several seeds, each from a reference of the same seed.

    Attributes:
        variants: name -> variant; the reference is among them.
        seeds: of the runs.
        scorer: scores every policy.
        folder: for the runs and their labels. Finished runs in it are not repeated,
            and interrupted ones are resumed.
        processes: runs at a time; one for each usable CPU unless given.
    """

    variants: Mapping[str, Variant]
    seeds: Sequence[int]
    scorer: Scorer
    folder: Path
    processes: int | None = None

    def rows(self) -> list[PreferenceRow]:
        """Train and score all variants, one stage after the other.

        Raises:
            UserError: a run failed, or its folder holds a run with other options.
            KeyboardInterrupt: it was interrupted, and the runs are saved.
        """
        reference = self.variants[REFERENCE]
        rows = list(self._stage([reference], 0))
        others = [v for v in self.variants.values() if v != reference]
        for stage in range(max((len(v.stages) for v in others), default=0)):
            rows += self._stage([v for v in others if stage < len(v.stages)], stage)
        return rows

    def _stage(
        self, variants: Sequence[Variant], stage: int
    ) -> Iterator[PreferenceRow]:
        cells = [(variant, seed) for variant in variants for seed in self.seeds]
        left = [cell for cell in cells if self._stored(*cell, stage) is None]
        runs = [self._config(*cell, stage) for cell in left]
        if runs and finish_runs(runs, self.processes) is None:
            raise KeyboardInterrupt
        for variant, seed in cells:
            yield self._row(variant, seed, stage)

    def _config(self, variant: Variant, seed: int, stage: int) -> TrainConfig:
        """Options of a run up to the end of a stage."""
        config = replace(
            variant.config,
            seed=seed,
            out=self._run(variant.name, seed),
            steps=variant.stages[stage],
            eval_every=variant.stages[stage],
        )
        if variant.name == REFERENCE:
            return config
        reference = {"reference": str(self._run(REFERENCE, seed))}
        config = replace(config, agent=replace(config.agent, **reference))
        if not variant.compares:
            return config
        labels = replace(config.labels, seed=seed)
        return replace(config, labels=labels, preferences=self._labels(variant, seed))

    def _run(self, name: str, seed: int) -> Path:
        plain = name.replace(",", "").replace(" ", "-")
        return self.folder / "runs" / f"{plain}-{seed}"

    def _labels(self, variant: Variant, seed: int) -> Path:
        return self.folder / "labels" / self._run(variant.name, seed).name

    def _row(self, variant: Variant, seed: int, stage: int) -> PreferenceRow:
        score = self._stored(variant, seed, stage)
        if score is None:
            score = self.scorer(
                self._run(variant.name, seed),
                self._run(REFERENCE, seed),
                self._labels(variant, seed) if variant.compares else None,
            )
            text = json.dumps(asdict(score), indent=2) + "\n"
            write_text(self._file(variant, seed, stage), text)
        return PreferenceRow(
            task=self.scorer.task,
            taste=self.scorer.taste,
            variant=variant.name,
            seed=seed,
            env_steps=variant.stages[stage],
            labels=variant.config.labels.total if variant.compares else 0,
            **asdict(score),
        )

    def _stored(self, variant: Variant, seed: int, stage: int) -> PolicyScore | None:
        """The score in the run folder, if there is one."""
        path = self._file(variant, seed, stage)
        if not path.is_file():
            return None
        try:
            score = build(PolicyScore, json.loads(path.read_text(encoding="utf-8")))
        except (ValueError, RecursionError) as error:
            message = f"{path} is damaged: {one_line(error)}; remove it"
            raise UserError(message) from error
        if score.episodes != self.scorer.episodes:
            raise UserError(
                f"{path} is of {score.episodes} episodes, not "
                f"{self.scorer.episodes}: choose another --out, or as many --episodes"
            )
        return score

    def _file(self, variant: Variant, seed: int, stage: int) -> Path:
        steps = variant.stages[stage]
        return self._run(variant.name, seed) / f"score-{steps}.json"
