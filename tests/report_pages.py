"""A report about a good and a failing policy, made in a few seconds."""

from copy import deepcopy
from dataclasses import replace
from functools import cache
from pathlib import Path

import torch

from manip.reports.page import make_page
from manip.reports.recorded_episodes import RecordedEpisodes, record_episodes
from manip.reports.replays import Replays, make_replays
from manip.reports.run_record import RunRecord, load_record
from manip.reports.sections import make_section

EPISODES, REPLAYS = 3, 2

Played = tuple[RunRecord, RecordedEpisodes, Replays]


@cache
def played(still: bool = False) -> Played:
    """Episodes of the shipped policy for Reach, or of one that does not move."""
    record = load_record(Path("Reach"))
    if still:
        actor = deepcopy(record.policy.actor)
        with torch.no_grad():
            for weights in actor.parameters():
                weights.zero_()
        record = replace(
            record, path=Path("still"), policy=replace(record.policy, actor=actor)
        )
    episodes = record_episodes(record.policy, record.task, EPISODES, seed=0)
    replays = make_replays(episodes, REPLAYS)
    assert replays is not None
    return record, episodes, replays


def page(*runs: Played) -> str:
    """The report about some runs."""
    return make_page([make_section(*run) for run in runs], [[] for _ in runs], "manip")
