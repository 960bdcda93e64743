"""Pixels of random textures: patterns of two colours."""

import numpy as np

Array = np.ndarray

SIZE = 64
"""Height and width of a pattern [pixels]."""

TRAINING, TEST = 12, 3
"""Number of patterns to train on, and to test on only."""


def training_pattern(number: int) -> Array:
    """A chequered, striped or cloudy pattern, uint8 [SIZE, SIZE, 3]."""
    rng = np.random.default_rng([1, number])
    kinds = (_checks, _stripes, _clouds)
    return _coloured(kinds[number % len(kinds)](rng), rng)


def test_pattern(number: int) -> Array:
    """A pattern of rings, bricks or dots, uint8 [SIZE, SIZE, 3]."""
    rng = np.random.default_rng([2, number])
    kinds = (_rings, _bricks, _dots)
    return _coloured(kinds[number % len(kinds)](rng), rng)


def _coloured(weight: Array, rng: np.random.Generator) -> Array:
    """Mix two random colours by weights [SIZE, SIZE] in [0, 1]."""
    one, other = rng.uniform(80, 255, (2, 3))
    mixed = one + (other - one) * weight[..., None]
    pixels: Array = mixed.astype(np.uint8)
    return pixels


_ROWS, _COLUMNS = np.meshgrid(np.arange(SIZE), np.arange(SIZE), indexing="ij")


def _checks(rng: np.random.Generator) -> Array:
    cell = rng.integers(4, 17)
    return ((_ROWS // cell + _COLUMNS // cell) % 2).astype(float)


def _stripes(rng: np.random.Generator) -> Array:
    waves, angle = rng.integers(2, 9), rng.uniform(0, np.pi)
    along = np.cos(angle) * _ROWS + np.sin(angle) * _COLUMNS
    return 0.5 + 0.5 * np.sign(np.sin(2 * np.pi * waves * along / SIZE))


def _clouds(rng: np.random.Generator) -> Array:
    """Noise whose spectrum falls with the square of the frequency."""
    frequency = np.fft.fftfreq(SIZE)
    squared = frequency[:, None] ** 2 + frequency[None] ** 2
    squared[0, 0] = np.inf
    noise = np.fft.fft2(rng.standard_normal((SIZE, SIZE)))
    values = np.real(np.fft.ifft2(noise / squared))
    weight: Array = (values - values.min()) / np.ptp(values)
    return weight


def _rings(rng: np.random.Generator) -> Array:
    centre, width = rng.uniform(0, SIZE, 2), rng.uniform(6, 14)
    radius = np.hypot(_ROWS - centre[0], _COLUMNS - centre[1])
    return 0.5 + 0.5 * np.sin(2 * np.pi * radius / width)


def _bricks(rng: np.random.Generator) -> Array:
    height = rng.integers(8, 17)
    shifted = _COLUMNS + height * (_ROWS // height % 2)
    return ((_ROWS % height > 1) & (shifted % (2 * height) > 1)).astype(float)


def _dots(rng: np.random.Generator) -> Array:
    period = rng.integers(10, 22)
    rows, columns = _ROWS % period - period / 2, _COLUMNS % period - period / 2
    return (np.hypot(rows, columns) < period / 3).astype(float)
