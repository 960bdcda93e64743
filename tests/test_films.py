"""scripts/films.py renders every task that has a shipped policy, and no other."""

from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path

import pytest

from manip.programs.list import catalogue

SCRIPT = Path(__file__).parents[1] / "scripts" / "films.py"


def test_tasks_without_a_shipped_policy_are_left_out(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    spec = spec_from_file_location("films", SCRIPT)
    films = module_from_spec(spec)
    spec.loader.exec_module(films)
    rendered = []
    monkeypatch.setattr(films, "render_video", rendered.append)
    assert films.main(["--out", str(tmp_path)]) == 0
    names = {str(options.run) for options in rendered}
    known = catalogue()
    assert names == set(known["tasks"]) & set(known["policies"])
    assert "NutAssembly" in set(known["tasks"]) - names
