"""Line charts as SVG inside a page, whose style sheet colours them."""

from collections.abc import Sequence
from dataclasses import dataclass
from math import ceil, floor, log10

from markupsafe import Markup

WIDTH, HEIGHT = 420, 240
"""Of the drawing [CSS pixels]; a page scales it to its column."""

_LEFT, _RIGHT, _TOP, _BOTTOM = 44, 12, 10, 36
_COLOURS = 8
"""Number of colours of the style sheet, which are used in turn."""
_MOST_DOTS = 40


@dataclass(frozen=True)
class Line:
    """A named curve; its points are marked if they are few."""

    name: str
    x: Sequence[float]
    y: Sequence[float]


@dataclass(frozen=True)
class Axis:
    """Label of an axis, its range (that of the data unless given), and a unit's sign.

    Values are multiplied by `scale` before they are shown.
    """

    label: str
    low: float | None = None
    high: float | None = None
    scale: float = 1.0
    unit: str = ""


def line_chart(title: str, lines: Sequence[Line], x: Axis, y: Axis) -> Markup:
    """Draw lines as a figure with a legend; empty if there is no point to draw."""
    lines = [line for line in lines if len(line.x)]
    if not lines:
        return Markup("")
    across = _Scale(x, [v for line in lines for v in line.x], _LEFT, WIDTH - _RIGHT)
    up = _Scale(y, [v for line in lines for v in line.y], HEIGHT - _BOTTOM, _TOP)
    parts = [_grid(across, up, x, y)]
    parts += [_curve(i, line, across, up, y) for i, line in enumerate(lines)]
    drawing = Markup(
        '<svg viewBox="0 0 {} {}" role="img" aria-label="{}">{}</svg>'
    ).format(WIDTH, HEIGHT, title, Markup("").join(parts))
    return Markup(
        '<figure class="chart"><figcaption>{}</figcaption>{}{}</figure>'
    ).format(title, drawing, _legend(lines))


class _Scale:
    """Map values to pixels between `start` and `end`."""

    def __init__(
        self, axis: Axis, values: Sequence[float], start: float, end: float
    ) -> None:
        scaled = [value * axis.scale for value in values]
        low = min(scaled) if axis.low is None else axis.low
        high = max(scaled) if axis.high is None else axis.high
        self._factor = axis.scale
        if high - low < 1e-9:
            low, high = low - 0.5, high + 0.5
        self.ticks = _ticks(low, high)
        self._low = min(low, self.ticks[0]) if axis.low is None else low
        self._high = max(high, self.ticks[-1]) if axis.high is None else high
        self._start, self._end = start, end

    def at(self, value: float) -> float:
        """Pixel of a value of the data."""
        return self.at_shown(value * self._factor)

    def at_shown(self, value: float) -> float:
        """Pixel of a value as it is shown."""
        share = (value - self._low) / (self._high - self._low)
        return round(self._start + share * (self._end - self._start), 1)


def _ticks(low: float, high: float) -> list[float]:
    """Three to six round numbers that span the range."""
    rough = (high - low) / 4
    power = 10 ** floor(log10(rough))
    step = next(power * n for n in (1, 2, 2.5, 5, 10) if power * n >= rough)
    first, last = ceil(low / step - 1e-6), floor(high / step + 1e-6)
    return [i * step for i in range(first, last + 1)] or [low, high]


def _grid(across: _Scale, up: _Scale, x: Axis, y: Axis) -> Markup:
    rule = Markup('<line class="{}" x1="{}" y1="{}" x2="{}" y2="{}"/>')
    text = Markup('<text class="{}" x="{}" y="{}">{}</text>')
    low, right = HEIGHT - _BOTTOM, WIDTH - _RIGHT
    parts = []
    for value in up.ticks:
        at = up.at_shown(value)
        parts.append(rule.format("grid", _LEFT, at, right, at))
        parts.append(text.format("tick end", _LEFT - 6, at + 4, f"{value:g}{y.unit}"))
    for value in across.ticks:
        at = across.at_shown(value)
        parts.append(rule.format("grid", at, _TOP, at, low))
        parts.append(text.format("tick middle", at, low + 14, f"{value:g}{x.unit}"))
    parts.append(rule.format("axis", _LEFT, low, right, low))
    middle = (_LEFT + right) / 2
    parts.append(text.format("label middle", middle, HEIGHT - 5, x.label))
    return Markup("").join(parts)


def _curve(index: int, line: Line, across: _Scale, up: _Scale, y: Axis) -> Markup:
    points = [(across.at(a), up.at(b)) for a, b in zip(line.x, line.y, strict=True)]
    path = " ".join(f"{a},{b}" for a, b in points)
    colour = f"c{index % _COLOURS}"
    parts = [Markup('<polyline class="{}" points="{}"/>').format(colour, path)]
    if len(points) <= _MOST_DOTS:
        for (a, b), value in zip(points, line.y, strict=True):
            label = f"{line.name}: {value * y.scale:.4g}{y.unit}"
            dot = '<circle class="{}" cx="{}" cy="{}" r="3"><title>{}</title></circle>'
            parts.append(Markup(dot).format(colour, a, b, label))
    return Markup("").join(parts)


def _legend(lines: Sequence[Line]) -> Markup:
    items = [
        Markup('<span><i class="c{}"></i>{}</span>').format(i % _COLOURS, line.name)
        for i, line in enumerate(lines)
    ]
    return Markup('<div class="legend">{}</div>').format(Markup("").join(items))
