"""SAC updates and PPO epochs a second, against other libraries.

Same nets, batch and buffer for all, filled with random transitions; everybody on one
thread and on all CPUs, and the better of both counts in the ratios. A SAC update moves
critics, actor, temperature and targets; our critics have LayerNorm, the others' have
not, and only ours can delay the actor, as it does by default (a contestant of its own,
in no ratio). An epoch of PPO is a pass over 4096 steps in minibatches of 512, with its
share of the rollout's actions, values and advantages.
"""

from collections.abc import Callable, Mapping
from functools import partial

import numpy as np

from manip.agents.sac import SACConfig
from manip.benchmarks import arithmetic, learner_ours, learner_torchrl
from manip.benchmarks.contest import Contest, Contestant, Settings, speed
from manip.benchmarks.peers import peer
from manip.benchmarks.problem import Problem
from manip.cpus import usable_cpus

Rounds = Mapping[str, list[float]]
Maker = Callable[[Problem], Callable[[int], int]]
"""Makes a learner of a peer: a function of the number of threads, for a round."""

PROBLEMS = (Problem(hidden=(128, 128)), Problem(hidden=(256, 256)))

SAC, PPO = "SAC", "PPO"
OURS, SB3, TORCHRL = "manip", "SB3", "TorchRL script"

FIGURES = {SAC: "sac_updates", PPO: "ppo_epoch"}
VERSUS = {SB3: "vs_sb3", TORCHRL: "vs_torchrl"}


def contest(settings: Settings) -> Contest:
    """Everybody's SAC and PPO, with two sizes of net."""
    sb3 = peer("learner_sb3")
    peers = {
        (SAC, SB3): sb3.sac,
        (PPO, SB3): sb3.ppo,
        (SAC, TORCHRL): learner_torchrl.sac,
        (PPO, TORCHRL): learner_torchrl.ppo,
    }
    peak = arithmetic.core_peak()
    contestants: dict[str, Contestant] = {}
    facts = {"core_peak_gflops": peak / 1e9}
    for problem in PROBLEMS:
        contestants |= _ours(problem) | _theirs(problem, peers)
        for what in FIGURES:
            cost = operations(problem, what) / 1e9
            facts[f"{FIGURES[what]}_gflop_{_net(problem)}"] = cost
    return Contest(
        "observation 44, action 7, SAC batch 256, PPO 4096 steps by 512",
        contestants,
        facts=facts,
        derive=partial(figures, problems=PROBLEMS, core_peak=peak),
        unit="updates or epochs/s",
    )


def operations(problem: Problem, what: str) -> float:
    """Operations of an update or an epoch; see `arithmetic`."""
    sizes = (problem.observation, problem.action, problem.hidden)
    if what == PPO:
        return arithmetic.ppo_epoch(*sizes, problem.rows)
    return arithmetic.sac_update(*sizes, problem.batch)


def figures(
    rounds: Rounds, problems: tuple[Problem, ...], core_peak: float
) -> dict[str, float]:
    """Ratios to the peers, and our share of the matrix peak, by net and the least."""
    found: dict[str, float] = {}
    for what, figure in FIGURES.items():
        for who, versus in VERSUS.items():
            ratios = [_ratio(rounds, what, problem, who) for problem in problems]
            found[f"{figure}_{versus}"] = min(ratios)
            for problem, ratio in zip(problems, ratios, strict=True):
                found[f"{figure}_{versus}_{_net(problem)}"] = ratio
        for problem in problems:
            share = _share(rounds, what, problem, core_peak)
            found[f"{figure}_share_of_peak_{_net(problem)}"] = share
    return found


def _ratio(rounds: Rounds, what: str, problem: Problem, who: str) -> float:
    """Our best against their best, median over the rounds."""
    mine, theirs = (
        rounds[_best(rounds, what, problem, name)[0]] for name in (OURS, who)
    )
    return float(np.median(np.divide(mine, theirs)))


def _share(rounds: Rounds, what: str, problem: Problem, core_peak: float) -> float:
    name, threads = _best(rounds, what, problem, OURS)
    done = float(np.median(rounds[name])) * operations(problem, what)
    return done / (core_peak * threads)


def _best(rounds: Rounds, what: str, problem: Problem, who: str) -> tuple[str, int]:
    """The contestant with the number of threads that suits it best, and that number."""
    names = {_name(what, problem, who, n): n for n in _thread_counts()}
    best = max(names, key=lambda name: float(np.median(rounds[name])))
    return best, names[best]


def _ours(problem: Problem) -> dict[str, Contestant]:
    found: dict[str, Contestant] = {}
    delay = SACConfig.actor_delay
    for threads in _thread_counts():
        named = partial(_name, problem=problem, who=OURS, threads=threads)
        found[named(SAC)] = speed(learner_ours.sac(problem, threads, actor_delay=1))
        delayed = speed(learner_ours.sac(problem, threads, delay))
        found[f"{named(SAC)}, actor delay {delay}"] = delayed
        found[named(PPO)] = speed(learner_ours.ppo(problem, threads))
    return found


def _theirs(
    problem: Problem, makers: Mapping[tuple[str, str], Maker]
) -> dict[str, Contestant]:
    found: dict[str, Contestant] = {}
    for (what, who), make in makers.items():
        go = make(problem)
        for threads in _thread_counts():
            found[_name(what, problem, who, threads)] = speed(partial(go, threads))
    return found


def _thread_counts() -> tuple[int, ...]:
    return tuple(sorted({1, usable_cpus()}))


def _name(what: str, problem: Problem, who: str, threads: int) -> str:
    return f"{what} {_net(problem)}, {who}, {threads} thread{'s' * (threads > 1)}"


def _net(problem: Problem) -> str:
    return f"{len(problem.hidden)}x{problem.hidden[0]}"
