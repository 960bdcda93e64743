"""The report as one HTML page that loads nothing from anywhere else."""

import base64
import gzip
import hashlib
from collections.abc import Mapping, Sequence
from functools import cache
from importlib.resources import files
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from manip.cpus import machine
from manip.reports.films import Film
from manip.reports.run_record import RunRecord
from manip.reports.sections import RunSection, flat_options, shown_value
from manip.reports.training_charts import compared_charts
from manip.versions import versions


def make_page(
    sections: Sequence[RunSection], films: Sequence[Sequence[Film]], command: str
) -> str:
    """The page's text. All values are escaped: a policy's card is not trusted.

    Args:
        sections: at least one.
        films: of each section.
        command: the command line that made the report.
    """
    records = [section.record for section in sections]
    replayed = any(section.replays for section in sections)
    viewer, script = _static("model-viewer.min.js"), _static("report.js")
    return (
        _environment()
        .get_template("report.html")
        .render(
            title=" and ".join(dict.fromkeys(record.title for record in records)),
            sections=sections,
            compared=compared_charts(records),
            differences=_differences(records),
            scenes=[_packed(section) for section in sections],
            videos=films,
            policy=_policy(viewer, script),
            css=Markup(_static("report.css")),
            viewer=Markup(viewer) if replayed else "",
            script=Markup(script),
            machine=machine(),
            versions=versions(),
            command=command,
        )
    )


def _policy(*scripts: str) -> str:
    """The Content-Security-Policy: these scripts, and no network.

    The viewer reads the scene from a blob: address of the page itself, and compiles a
    decoder when it starts, which the page does not use.
    """
    hashes = " ".join(f"'sha256-{_sha256(script)}'" for script in scripts)
    return (
        f"default-src 'none'; script-src 'wasm-unsafe-eval' {hashes}; "
        "style-src 'unsafe-inline'; img-src data: blob:; media-src data:; "
        "connect-src blob:; base-uri 'none'; form-action 'none'"
    )


def _sha256(text: str) -> str:
    return base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()


def _packed(section: RunSection) -> Markup:
    """The scene of the replays, compressed, in base 64."""
    if section.replays is None:
        return Markup("")
    packed = gzip.compress(section.replays.scene, 9, mtime=0)
    return Markup(base64.b64encode(packed).decode())


def _differences(records: Sequence[RunRecord]) -> list[tuple[str, list[str]]]:
    """Option -> its value in each run, where the runs with a record differ."""
    options: list[Mapping[str, Any]] = [flat_options(record) for record in records]
    known = [option for option in options if option]
    names = dict.fromkeys(name for option in known for name in option)
    return [
        (name, [_cell(option, name) for option in options])
        for name in names
        if any(option.get(name) != known[0].get(name) for option in known)
    ]


def _cell(options: Mapping[str, Any], name: str) -> str:
    return shown_value(options[name]) if name in options else "–"


def _static(name: str) -> str:
    return (files("manip.reports") / "static" / name).read_text(encoding="utf-8")


@cache
def _environment() -> Environment:
    environment = Environment(
        loader=PackageLoader("manip.reports"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.policies["json.dumps_kwargs"] = {"sort_keys": False}
    return environment
