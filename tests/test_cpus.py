"""The name of the processor includes its generation, on which results depend."""

import pytest

from manip.cpus import machine, processor


def described(name: str, family: int, model: int) -> str:
    """Part of the text of /proc/cpuinfo."""
    return (
        f"processor\t: 0\nvendor_id\t: x\ncpu family\t: {family}\n"
        f"model\t\t: {model}\nmodel name\t: {name}\nstepping\t: 1\n"
    )


@pytest.mark.parametrize(
    ("name", "family", "model", "expected"),
    [
        ("AMD EPYC", 25, 1, "AMD EPYC (Zen 3)"),
        ("AMD EPYC", 25, 17, "AMD EPYC (Zen 4)"),
        ("AMD EPYC", 26, 2, "AMD EPYC (Zen 5)"),
        ("AMD EPYC 7551", 23, 1, "AMD EPYC 7551"),
        ("Intel(R) Xeon(R) Processor", 6, 143, "Intel(R) Xeon(R) Processor"),
    ],
)
def test_the_generation_follows_from_family_and_model(name, family, model, expected):
    assert processor(described(name, family, model)) == expected


def test_a_machine_without_cpuinfo_has_a_name_too():
    assert processor("") == ""
    assert "CPU" in machine()
