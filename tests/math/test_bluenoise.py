"""The blue-noise tile that the package ships: made by its script, a permutation, and blue."""

from pathlib import Path

import bluenoise
import numpy as np
import pytest

import hpcomp

SHARES = (0.02, 0.1, 0.25, 0.5, 0.75, 0.9, 0.98)


@pytest.fixture(scope="module")
def tile():
    return np.load(Path(hpcomp.__file__).parent / "blending" / "bluenoise.npy")


def below(tile, share):
    """The pixels below that share of the ranks."""
    return tile < round(share * tile.size)


def radial_power(pattern):
    """The mean power at each whole frequency, in periods a tile; white noise has 1 at all of them."""
    share = pattern.mean()
    spectrum = np.abs(np.fft.fft2(pattern - share)) ** 2 / (pattern.size * share * (1 - share))
    steps = np.fft.fftfreq(bluenoise.SIZE, 1 / bluenoise.SIZE)
    frequency = np.rint(np.hypot(steps[:, None], steps)).astype(int).ravel()
    return np.bincount(frequency, spectrum.ravel()) / np.bincount(frequency)


def test_is_a_permutation_of_the_ranks(tile):
    assert (tile.shape, tile.dtype) == ((bluenoise.SIZE, bluenoise.SIZE), np.uint16)
    assert np.array_equal(np.sort(tile, axis=None), np.arange(tile.size))


@pytest.mark.slow
def test_is_what_the_script_makes(tile):
    assert np.array_equal(tile, bluenoise.tile())


def test_sums_of_energy_stay_apart_and_exact():
    # The wider filter never carries into the first one, and all together fit an int64.
    table = bluenoise.energy_table()[: bluenoise.SIZE, : bluenoise.SIZE]
    assert (table % bluenoise.FIRST).sum() < bluenoise.FIRST
    assert sum(int(row.sum()) for row in table) < 2**62


def low_and_principal(pattern):
    """The most power up to a quarter of the principal frequency, and the most around that.

    Points are √(1/share) pixels apart, of the kind of which there are fewer.
    """
    share = pattern.mean()
    principal = bluenoise.SIZE * np.sqrt(min(share, 1 - share))
    power = radial_power(pattern)
    return power[1 : int(principal / 4)].max(), power[int(principal / 2) : int(2 * principal)].max()


@pytest.mark.parametrize("share", SHARES)
def test_low_frequencies_have_far_less_power_than_white_noise(tile, share):
    low, principal = low_and_principal(below(tile, share))
    assert low < 0.15
    assert principal > 1.4
    # Ranks in random order have as much power at each frequency.
    white = np.random.default_rng(1).permutation(tile.ravel()).reshape(tile.shape)
    low, _ = low_and_principal(below(white, share))
    assert low > 0.7


@pytest.mark.parametrize("share", SHARES)
def test_every_window_of_the_torus_has_its_share(tile, share):
    # Windows of 16×16: with white noise their counts scatter by √(256·share·(1 − share)), up to 8.
    n = 16
    around = np.pad(below(tile, share), ((0, n), (0, n)), mode="wrap")
    sums = np.pad(around.cumsum(0).cumsum(1), ((1, 0), (1, 0)))
    counts = sums[n:, n:] - sums[:-n, n:] - sums[n:, :-n] + sums[:-n, :-n]
    expected = n * n * share
    assert np.abs(counts - expected).max() <= 9
    assert counts.std() < 0.5 * np.sqrt(expected * (1 - share))
