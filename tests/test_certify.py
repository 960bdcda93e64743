"""`manip certify`: tables and verdict; the comparison itself in the slow tests."""

from dataclasses import replace

import pytest

from manip.evaluation.statistics import wilson_rate
from manip.programs import certify, cli
from manip.sim.warp.contact_differences import ContactDifferences
from manip.training.certificate import Certificate

GOOD = Certificate(
    "Lift",
    "Panda",
    "cpu",
    64,
    success={
        "expert": {env: wilson_rate(64, 64) for env in ("native", "warp")},
        "Lift": {env: wilson_rate(62, 64) for env in ("native", "warp", "stock")},
    },
    equal_flags={"expert": 1.0, "Lift": 63 / 64},
    differences={1: (4e-7, 1e-6), 50: (1e-5, 3e-4)},
    contacts={"box-box": ContactDifferences(3, 2, 2, [8e-5], [], 1e-7)},
)


def test_agreement_says_what_may_be_quoted() -> None:
    assert GOOD.exact
    assert GOOD.trains
    lines = list(certify.verdict(GOOD))
    assert lines[0].startswith("quote results from: stock robosuite, or the native")
    assert lines[1].startswith("warp: train on it; do not quote")


def test_states_or_success_apart_are_too_far() -> None:
    apart = replace(GOOD, differences={50: (2e-4, 3e-4)})
    rates = {"native": wilson_rate(64, 64), "warp": wilson_rate(60, 64)}
    worse = replace(GOOD, success={"expert": rates})
    for one in (apart, worse):
        assert not one.trains
        assert list(certify.verdict(one))[-1].startswith("warp: too far from C")


def test_problems_against_stock_forbid_quoting_native_results() -> None:
    one = replace(GOOD, stock_problems=["steps differ: success by 1 after 10"])
    assert not one.exact
    lines = list(certify.verdict(one))
    assert lines[0] == "C differs from stock robosuite: steps differ: success by 1 " + (
        "after 10"
    )
    assert lines[1] == "quote results from: stock robosuite only"


def test_the_program_prints_tables_and_writes_json(
    monkeypatch: pytest.MonkeyPatch, tmp_path, capsys
) -> None:
    monkeypatch.setattr(certify, "certify", lambda options, say: GOOD)
    path = tmp_path / "lift.json"
    assert cli.run(certify.main, ["Lift", "--device", "cpu", "--json", str(path)]) == 0
    shown = capsys.readouterr().out
    for text in ("98.4%", "100.0 (94-100)", "4.0e-07", "8.0e-05", "quote results"):
        assert text in shown
    assert '"trains": true' in path.read_text()


def test_contacts_are_counted_by_pairs() -> None:
    one = ContactDifferences()
    one.add([1e-3, 2e-3], [1e-3])
    one.add([5e-4], [])
    one.add([], [3e-4, 1e-4])
    one.add([1e-7], [])  # shallower than the rounding
    assert (one.native, one.warp, one.pairs) == (4, 3, 1)
    assert (one.missed, one.ghosts, one.depth) == ([5e-4], [3e-4], 1e-3)
