"""The order `simultaneous` with many terms in a pixel: the kernel against the reference in doubles."""

import subprocess
import sys
from threading import Event

import numpy as np
import pytest
from agreement import assert_agree
from command import PATIENCE_S
from engines import run_arrays, strips_of
from strategies import color_of, hue_direction

from hpcomp.blending import addition
from hpcomp.engine import choice as engine
from hpcomp.engine import reference
from hpcomp.kernel import _kernel
from hpcomp.kernel import fused as kernel
from hpcomp.options import stack_rules
from hpcomp.system.threads import ThreadPipeline

#: Terms up to which the kernel has a table of all pairs of a pixel, and of several side by side.
PAIRED, TABLED = 32, 64
#: Of the sum of all colours: each is rounded to float32, and so is each sum.
ROUNDING = 2e-6

TOLERANCES = (0, 0.5, 2, 20, 45, 46, 60, 90)


def many_terms(hues_deg, width=6, seed=0):
    """(terms, 1, width, 4): a colour of each hue in every pixel, of chroma from nothing to all."""
    rng = np.random.default_rng(seed)
    hues_deg = np.broadcast_to(np.asarray(hues_deg, float).T, (width, len(hues_deg))).T
    angle = np.radians(hues_deg)[..., None]
    direction = np.cos(angle) * hue_direction(0) + np.sin(angle) * hue_direction(90)
    strength = rng.random(hues_deg.shape) ** 3
    colors = (0.3 + 0.2 * direction) * strength[..., None] / len(hues_deg)
    layers = np.concatenate([colors, np.full((*hues_deg.shape, 1), 0.5)], axis=-1)
    return layers[:, None].astype(np.float32)


def hues_of(kind, n, seed=0):
    rng = np.random.default_rng(seed)
    return {
        "anywhere": lambda: rng.uniform(-180, 180, (n, 6)),
        # Three labels, two of them within one shoulder of the other; each with its rounding.
        "labels": lambda: rng.choice([-179, 2, 5.5], (n, 6)) + rng.normal(0, 0.05, (n, 6)),
        "a band": lambda: rng.uniform(174, 186, (n, 6)),
        "one": lambda: np.full((n, 6), 40.0),
    }[kind]()


def assert_agrees(rules, layers):
    expected = run_arrays(reference, rules, layers.astype(float), "float64", dtype=float).samples
    found = run_arrays(kernel, rules, layers).samples
    largest = np.abs(layers[..., :3]).max(axis=-1).sum(axis=0).max()
    assert np.abs(found - expected)[..., :3].max() <= ROUNDING * largest
    return found


@pytest.mark.pairwise
@pytest.mark.parametrize("gray_bias", [0, 0.4])
@pytest.mark.parametrize("hue_tolerance", TOLERANCES)
@pytest.mark.parametrize("kind", ["anywhere", "labels", "a band", "one"])
@pytest.mark.parametrize("n", [PAIRED, PAIRED + 1, TABLED + 1, 130])
def test_any_number_of_terms(n, kind, hue_tolerance, gray_bias):
    rules = stack_rules(
        n, op="plus", order="simultaneous", hue_tolerance=hue_tolerance, gray_bias=gray_bias
    )
    assert_agrees(rules, many_terms(hues_of(kind, n)))


def sum_by_matrices(p, hue_tolerance):
    """The rule for p (n, 2), as the products of matrices of all pairs; (2)."""
    m, hue = np.hypot(*p.T), np.arctan2(*p.T[::-1])
    angle = np.abs(hue[:, None] - hue)
    angle = np.degrees(np.minimum(angle, 2 * np.pi - angle))
    t = np.clip(angle / hue_tolerance - 1, 0, 1)
    e = 1 - t**2 * (3 - 2 * t)
    support = (e * m).sum(axis=1)[:, None] - (e * m) @ e.T
    hold = np.minimum(m[:, None], m).sum(axis=1)
    strength = np.minimum(support.T, hold)
    q = np.divide(strength, support, out=np.zeros_like(e), where=support > 1e-12)
    part = ((1 - e) * np.clip(q, 0, 1)).max(axis=1)
    return ((1 - part)[:, None] * p).sum(axis=0)


@pytest.mark.slow
@pytest.mark.parametrize("hue_tolerance", [2, 60])
@pytest.mark.parametrize("kind", ["anywhere", "labels", "a band"])
def test_thousands_of_terms(kind, hue_tolerance):
    layers = many_terms(hues_of(kind, 2000)[:, :1], 1)
    rules = stack_rules(2000, op="plus", order="simultaneous", hue_tolerance=hue_tolerance)
    found = run_arrays(kernel, rules, layers).samples[0, 0, :3].astype(float)
    _, terms = rules.space.forward(layers[:, 0, 0, :3].T.astype(float))
    _, p = rules.space.forward(found[:, None])
    expected = sum_by_matrices(terms.T, hue_tolerance)
    assert np.abs(p[:, 0] - expected).max() <= 1e-5 * np.hypot(*terms).sum()


@pytest.mark.parametrize("at_once", [1, 70 * 9, 1 << 20])
@pytest.mark.parametrize("gray_bias", [0, 0.4])
@pytest.mark.parametrize("hue_tolerance", [0, 2, 60])
@pytest.mark.parametrize("kind", ["anywhere", "labels", "a band", "one"])
def test_the_strongest_rivals_are_those_of_the_table(
    monkeypatch, kind, hue_tolerance, gray_bias, at_once
):
    """However many shoulders are tabled at a time."""
    layers = many_terms(hues_of(kind, 70)[:, :1], 1)
    _, terms = stack_rules(1).space.forward(layers[:, 0, 0, :3].T.astype(float))
    table = addition.rivalry(terms.T[..., None], hue_tolerance, gray_bias)[..., 0]
    monkeypatch.setattr(addition, "SHOULDERS_AT_ONCE", at_once)
    share, rival = addition.strongest_rivals(terms, hue_tolerance, gray_bias)
    assert np.abs(share - table.max(axis=1)).max() < 1e-9
    assert np.abs(table[np.arange(70), rival] - table.max(axis=1)).max() < 1e-9


@pytest.mark.parametrize("blending", ["hue-preserving", "traditional"])
@pytest.mark.parametrize("size", [1e-30, 1, 1e30])
def test_runs_of_any_length(blending, size):
    """Also of none and of terms without chroma: each run by itself, in both engines."""
    counts = np.array([0, 1, 2, 33, 0, 70, 5, 1])
    layers = many_terms(hues_of("labels", counts.sum())[:, :1], 1)
    rules = stack_rules(1, blending=blending, order="simultaneous")
    _, p = rules.space.forward(layers[:, 0, 0, :3].T.astype(float) * size)
    p[:, ::7] = 0
    found = [by.ENGINE.keep_runs(rules, counts, p, None) for by in (kernel, reference)]
    assert np.abs(found[0] - found[1]).max() <= 1e-6
    assert all(((kept >= 0) & (kept <= 1)).all() for kept in found)
    assert all((kept[~p.any(axis=0)] == 1).all() for kept in found)
    for run, (end, count) in enumerate(zip(np.cumsum(counts), counts, strict=True)):
        alone = p[:, end - count : end].copy()
        for kept, by in zip(found, (kernel, reference), strict=True):
            of_run = by.ENGINE.keep_runs(rules, counts[run : run + 1], alone, None)
            assert np.array_equal(of_run, kept[end - count : end])


def test_memory_of_the_reference_does_not_follow_the_square_of_the_number_of_terms():
    rules = stack_rules(1, order="simultaneous")
    for ask in (lambda n: reference.ENGINE.bytes_to_reduce(rules, n), reference.ENGINE.bytes_to_keep):
        assert ask(2) < 1000
        assert ask(100_000) == ask(2000)


def test_a_rival_anywhere_on_the_circle_counts():
    """One strong rival, wherever the many others are: at each hue, and across ±180°."""
    rules = stack_rules(41, op="plus", order="simultaneous")
    for hue in range(-180, 181, 9):
        layers = many_terms([hue, *([hue + 4.5] * 20), *([hue - 120] * 20)])
        layers[0, ..., :3] /= 2 * layers[0, ..., :3].max(axis=-1, keepdims=True)
        found = assert_agrees(rules, layers)
        _, p = rules.space.forward(np.moveaxis(found[0], -1, 0)[:3].astype(float))
        assert np.hypot(*p).min() > 0.05
        _, alone = rules.space.forward(np.array(color_of(hue, 0.1, 0.3))[:, None])
        turned = np.arctan2(alone[0] * p[1] - alone[1] * p[0], (alone * p).sum(axis=0))
        assert abs(np.degrees(turned)).max() < 5


@pytest.mark.parametrize("space", ["oklab", "cielab", "hsl"])
def test_other_spaces(space):
    layers = many_terms(hues_of("labels", 50))
    rules = stack_rules(50, op="plus", order="simultaneous", space=space)
    expected = run_arrays(reference, rules, layers).samples
    assert np.abs(run_arrays(kernel, rules, layers).samples - expected).max() < 2e-5


@pytest.mark.parametrize("size", [2.0**-100, 2.0**100])
def test_colours_of_any_size(size):
    rules = stack_rules(70, op="plus", order="simultaneous")
    layers = many_terms(hues_of("labels", 70))
    scale = np.array([size] * 3 + [1], np.float32)
    found = run_arrays(kernel, rules, layers * scale).samples
    assert np.array_equal(found, run_arrays(kernel, rules, layers).samples * scale)


def mixed(width=50):
    """(150, 1, width, 4): in each pixel some of the terms alone, from none to all of them."""
    layers = many_terms(hues_of("anywhere", 150)[:, :1], width)
    rng = np.random.default_rng(3)
    wanted = rng.choice([0, 1, 20, PAIRED, PAIRED + 1, 50, 100, 150], width)
    wanted[16:32] = rng.integers(1, PAIRED, 16)  # each has few, together they have many
    wanted[32:48] = rng.integers(PAIRED - 9, PAIRED + 9, 16)
    first = np.where(np.arange(width) // 16 == 2, 0, rng.integers(0, 150, width))
    there = (np.arange(150)[:, None] - first) % 150 < wanted
    layers[~there[:, None]] = 0
    return layers


def test_pixels_beside_it_do_not_matter():
    layers = mixed()
    rules = stack_rules(150, op="plus", order="simultaneous")
    together = assert_agrees(rules, layers)
    for x in range(layers.shape[2]):
        alone = run_arrays(kernel, rules, layers[:, :, x : x + 1]).samples
        assert alone.tobytes() == together[:, x : x + 1].tobytes(), x


def test_the_instruction_set_does_not_matter(monkeypatch):
    layers = mixed()
    made = set()
    for level in kernel.levels():
        monkeypatch.setenv(kernel.LEVEL_VARIABLE, level)
        for gray_bias in (0, 0.4):
            rules = stack_rules(150, op="plus", order="simultaneous", gray_bias=gray_bias)
            made.add((gray_bias, run_arrays(kernel, rules, layers).samples.tobytes()))
    assert len(made) == 2


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_what_is_no_number_stays_in_its_pixel(value):
    layers = mixed()
    rules = stack_rules(150, op="plus", order="simultaneous")
    whole = run_arrays(kernel, rules, layers).samples
    at = int((layers[:, 0, :, 3] > 0).sum(axis=0).argmax())
    layers[70, 0, at, 1] = value
    found = run_arrays(kernel, rules, layers).samples
    assert np.isnan(found[0, at, 1]) if np.isnan(value) else found[0, at, 1] == value
    assert np.isfinite(found[0, at, ::2]).all()  # it is added there, as all is
    others = np.arange(layers.shape[2]) != at
    assert np.array_equal(found[:, others], whole[:, others])


def test_reports_of_many_terms():
    layers = mixed()
    assert_agree(stack_rules(150, op="plus", order="simultaneous"), strips_of(layers), 50, 1)


def test_memory_grows_as_the_number_of_terms():
    rules = stack_rules(2, order="simultaneous")
    one, ten = (kernel.ENGINE.bytes_to_reduce(rules, n) for n in (2000, 20_000))
    assert one > 2000 * 9000
    assert ten < 10.1 * one
    assert kernel.ENGINE.bytes_to_reduce(stack_rules(2, order="bottom-up"), 2000) == 0
    with pytest.raises(TypeError):
        _kernel.scratch_bytes(order="simultaneous", layers=3)


# ---- threads ---------------------------------------------------------------------------------


WITHOUT_KERNEL = """
import sys
from concurrent.futures import ThreadPoolExecutor

class Missing:
    looked_for = 0

    def find_spec(self, name, path=None, target=None):
        if name == "hpcomp.kernel._kernel":
            self.looked_for += 1
            raise ImportError(name)

missing = Missing()
sys.meta_path.insert(0, missing)
from hpcomp.blending import addition
from hpcomp.engine import choice as engine
from hpcomp.options import stack_rules
with ThreadPoolExecutor(8) as pool:
    made = list(pool.map(lambda _: engine.start(stack_rules(1), 3, 2), range(64)))
print({type(accumulator).__module__ for accumulator in made}, missing.looked_for)
"""


def test_a_kernel_that_is_not_there_is_looked_for_once(monkeypatch, tmp_path):
    """Threads that look for it again and again come upon what is left of each other's attempts."""
    monkeypatch.delenv(engine.VARIABLE, raising=False)
    done = subprocess.run(
        [sys.executable, "-c", WITHOUT_KERNEL], cwd=tmp_path, capture_output=True, text=True
    )
    assert done.stdout == "{'hpcomp.engine.reference'} 1\n"
    assert done.stderr.count("HpcompWarning: the kernel was not built") == 1
    assert "Error" not in done.stderr


def test_work_that_nobody_waits_for_ends():
    begun = Event()

    def endless():
        begun.set()
        while True:
            pipeline.go_on()

    def fail_meanwhile():
        with pipeline:
            next(pipeline.read_ahead([(0, lambda: 1), *((n, endless) for n in range(1, 9))]))
            assert begun.wait(PATIENCE_S)
            raise KeyError

    pipeline = ThreadPipeline(2)
    with pytest.raises(KeyError):
        fail_meanwhile()
