"""SAC updates and PPO epochs per second, compared with other libraries.

Network sizes, batch and buffer are the same for all, and the data is random. Each
learner runs on one thread and on all CPUs, and the better of both enters the ratios. A
SAC update trains critics, actor and temperature and moves the target networks. manip's
critics have LayerNorm, the others' do not. Only manip can delay the actor (its
default): that is a separate candidate, which enters no ratio. A PPO epoch is a pass
over 4096 steps in minibatches of 512, with its share of the rollout's actions, values
and advantages.
"""

from collections.abc import Callable, Mapping
from functools import partial

import numpy as np

from manip.agents.sac import SACConfig
from manip.benchmarks import flop_counts, learner_manip, learner_torchrl
from manip.benchmarks.learner_problem import Problem
from manip.benchmarks.peers import import_peer
from manip.benchmarks.rounds import Candidate, Comparison, Settings, speed
from manip.cpus import usable_cpus

Rounds = Mapping[str, list[float]]
Maker = Callable[[Problem], Callable[[int], int]]
"""Builds a learner of another library: a function of the number of threads."""

PROBLEMS = (Problem(hidden=(128, 128)), Problem(hidden=(256, 256)))

SAC, PPO = "SAC", "PPO"
MANIP, SB3, TORCHRL = "manip", "SB3", "TorchRL script"

FIGURES = {SAC: "sac_updates", PPO: "ppo_epoch"}
VERSUS = {SB3: "vs_sb3", TORCHRL: "vs_torchrl"}


def comparison(settings: Settings) -> Comparison:
    """Compare SAC and PPO of all libraries, with two network sizes."""
    makers = _makers()
    peak = flop_counts.core_peak()
    candidates: dict[str, Candidate] = {}
    facts = {"core_peak_gflops": peak / 1e9}
    for problem in PROBLEMS:
        candidates |= _manip(problem) | _others(problem, makers)
        facts |= _gflop(problem)
    return Comparison(
        "observation 44, action 7, SAC batch 256, PPO 4096 steps by 512",
        candidates,
        facts=facts,
        derive=partial(figures, problems=PROBLEMS, core_peak=peak),
        unit="updates or epochs/s",
    )


def _makers() -> dict[tuple[str, str], Maker]:
    sb3 = import_peer("learner_sb3")
    return {
        (SAC, SB3): sb3.sac,
        (PPO, SB3): sb3.ppo,
        (SAC, TORCHRL): learner_torchrl.sac,
        (PPO, TORCHRL): learner_torchrl.ppo,
    }


def _gflop(problem: Problem) -> dict[str, float]:
    return {
        f"{figure}_gflop_{_net(problem)}": operations(problem, algo) / 1e9
        for algo, figure in FIGURES.items()
    }


def operations(problem: Problem, algo: str) -> float:
    """Operations of an update or an epoch; see `flop_counts`."""
    sizes = (problem.observation, problem.action, problem.hidden)
    if algo == PPO:
        return flop_counts.ppo_epoch(*sizes, problem.rows)
    return flop_counts.sac_update(*sizes, problem.batch)


def figures(
    rounds: Rounds, problems: tuple[Problem, ...], core_peak: float
) -> dict[str, float]:
    """Ratios to the other libraries (and their minimum over networks), peak fractions.

    Args:
        rounds: candidate -> updates or epochs per second, of each round.
        problems: network sizes.
        core_peak: operations per second of a core.
    """
    values: dict[str, float] = {}
    for algo, figure in FIGURES.items():
        for library, versus in VERSUS.items():
            ratios = {_net(p): _ratio(rounds, algo, p, library) for p in problems}
            values[f"{figure}_{versus}"] = min(ratios.values())
            values |= {f"{figure}_{versus}_{net}": r for net, r in ratios.items()}
        for problem in problems:
            fraction = _fraction_of_peak(rounds, algo, problem, core_peak)
            values[f"{figure}_share_of_peak_{_net(problem)}"] = fraction
    return values


def _ratio(rounds: Rounds, algo: str, problem: Problem, library: str) -> float:
    """manip's best candidate over the library's best, median over the rounds."""
    over, under = (
        rounds[_best(rounds, algo, problem, name)[0]] for name in (MANIP, library)
    )
    return float(np.median(np.divide(over, under)))


def _fraction_of_peak(
    rounds: Rounds, algo: str, problem: Problem, core_peak: float
) -> float:
    name, threads = _best(rounds, algo, problem, MANIP)
    rate = float(np.median(rounds[name])) * operations(problem, algo)
    return rate / (core_peak * threads)


def _best(rounds: Rounds, algo: str, problem: Problem, library: str) -> tuple[str, int]:
    """The faster candidate of a library, and its number of threads."""
    names = {_name(algo, problem, library, n): n for n in _thread_counts()}
    best = max(names, key=lambda name: float(np.median(rounds[name])))
    return best, names[best]


def _manip(problem: Problem) -> dict[str, Candidate]:
    candidates: dict[str, Candidate] = {}
    delay = SACConfig.actor_delay
    for threads in _thread_counts():
        sac, ppo = (_name(algo, problem, MANIP, threads) for algo in (SAC, PPO))
        candidates[sac] = speed(learner_manip.sac(problem, threads, actor_delay=1))
        delayed = learner_manip.sac(problem, threads, delay)
        candidates[f"{sac}, actor delay {delay}"] = speed(delayed)
        candidates[ppo] = speed(learner_manip.ppo(problem, threads))
    return candidates


def _others(
    problem: Problem, makers: Mapping[tuple[str, str], Maker]
) -> dict[str, Candidate]:
    candidates: dict[str, Candidate] = {}
    for (algo, library), make in makers.items():
        run = make(problem)
        for threads in _thread_counts():
            name = _name(algo, problem, library, threads)
            candidates[name] = speed(partial(run, threads))
    return candidates


def _thread_counts() -> tuple[int, ...]:
    return tuple(sorted({1, usable_cpus()}))


def _name(algo: str, problem: Problem, library: str, threads: int) -> str:
    return f"{algo} {_net(problem)}, {library}, {threads} thread{'s' * (threads > 1)}"


def _net(problem: Problem) -> str:
    return f"{len(problem.hidden)}x{problem.hidden[0]}"
