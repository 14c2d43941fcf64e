"""Samples along viewing rays: sorted by depth, split where they overlap, merged where at one place.

Colours are linear and premultiplied. How colours are added is not known here: what coincides is
handed to whoever knows, already weighted, or each sample as far as it is seen. OpenEXR:
Interpreting Deep Pixels.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..records import record

Ints = NDArray[np.integer[Any]]
Floats = NDArray[np.floating[Any]]
Bools = NDArray[np.bool_]

#: Adds the colours and alphas of each run: run lengths (runs), RGBA (samples, 4) → (runs, 4).
Merge = Callable[[Ints, Floats], Floats]

#: Pieces of split samples that are in memory at a time, beside what they are merged to.
PIECES_AT_ONCE = 1 << 15

#: Pixels with up to so many samples share layers with those of the same number alone.
_EXACT_COUNTS = 8


@record
class DeepSamples:
    """The samples of some pixels, one pixel after the other.

    `counts`: (pixels), how many each has. `front`, `back`: (samples) float32, any unit that grows
    with the distance; a `back` that is not behind its `front` makes a point of the sample.
    `rgba`: (samples, 4) float32, linear, premultiplied, alpha in [0, 1].
    """

    counts: Ints
    front: Floats
    back: Floats
    rgba: Floats

    @property
    def pixel(self) -> Ints:
        """(samples): the pixel of each."""
        return np.repeat(np.arange(len(self.counts)), self.counts)


def merged(images: Sequence[DeepSamples]) -> DeepSamples:
    """The samples of several images of the same pixels, pixel by pixel, in the images' order."""
    if len(images) == 1:
        return images[0]
    counts = np.sum([image.counts for image in images], axis=0)
    total = int(counts.sum())
    front, back = np.empty((2, total), np.float32)
    rgba = np.empty((total, 4), np.float32)
    begin = _starts(counts)
    for image in images:
        to = np.arange(len(image.front)) + np.repeat(begin - _starts(image.counts), image.counts)
        front[to], back[to], rgba[to] = image.front, image.back, image.rgba
        begin = begin + image.counts
    return DeepSamples(counts, front, back, rgba)


def tidied(samples: DeepSamples, merge: Merge) -> tuple[Ints, Floats]:
    """Sorted by depth, and none beside another: counts (pixels), RGBA (samples, 4), front first.

    Volumes are split where others begin or end; what then coincides becomes one sample by `merge`.
    The result does not depend on the order of a pixel's samples. OpenEXR: Interpreting Deep Pixels,
    Making an Image Tidy.
    """
    pixel = samples.pixel
    order, front, back, overlapping = _sorted(samples)
    rgba = samples.rgba[order]
    if not overlapping.any():
        return samples.counts, rgba
    split = overlapping[pixel]
    counts = samples.counts.copy()
    counts[overlapping] = 0
    pieces = _merged_pieces(pixel[split], front[split], back[split], rgba[split], merge)
    for pixels, _ in pieces:
        counts = counts + np.bincount(pixels, minlength=len(counts))

    begin = _starts(counts)
    result = np.empty((int(counts.sum()), 4), np.float32)
    shift = begin - _starts(samples.counts)
    keep = np.flatnonzero(~split)
    result[keep + shift[pixel[keep]]] = rgba[keep]
    for pixels, colors in pieces:
        first, lengths = _runs(pixels)
        within = np.arange(len(pixels)) - np.repeat(first, lengths)
        result[begin[pixels] + within] = colors
        begin[pixels[first]] += lengths
    return counts, result


def seen(samples: DeepSamples) -> tuple[Ints, Floats]:
    """Each sample as far as it is seen: counts (pixels), RGBA (samples, 4), which add up by +.

    Nothing is merged: a sample is scaled by its share of what coincides with it, times what is let
    through in front of it. Those that nothing is seen of are left out. The result does not depend
    on the order of a pixel's samples.
    """
    pixel = samples.pixel
    order, front, back, overlapping = _sorted(samples)
    rgba = samples.rgba[order]
    alpha, split = rgba[:, 3], overlapping[pixel]
    apart, cut = np.flatnonzero(~split), np.flatnonzero(split)
    weights = np.zeros(len(pixel))
    let_through = np.ones(len(samples.counts))
    weights[apart] = _in_front(let_through, pixel[apart], 1 - alpha[apart].astype(float))
    for pieces in _split(pixel[cut], front[cut], back[cut], alpha[cut]):
        in_front = _in_front(let_through, pieces.pixel, pieces.transmittance)
        of_pieces = np.repeat(in_front, pieces.lengths) * pieces.weights
        np.add.at(weights, cut[pieces.sample], of_pieces)
    some = weights != 0
    counts = np.bincount(pixel[some], minlength=len(samples.counts))
    return counts, (rgba[some] * weights[some, None]).astype(np.float32)


def visible(counts: Ints, rgba: Floats) -> tuple[Ints, Floats]:
    """Those in front of all opaque ones, and the first of these: front first, as `tidied` gives."""
    opaque = rgba[:, 3] >= 1
    if not opaque.any():
        return counts, rgba
    before = np.concatenate([[0], np.cumsum(opaque)])
    starts = _starts(counts)
    seen = before[:-1] == np.repeat(before[starts], counts)
    if seen.all():
        return counts, rgba
    seen_before = np.concatenate([[0], np.cumsum(seen)])
    return seen_before[starts + counts] - seen_before[starts], rgba[seen]


def layers(counts: Ints, rgba: Floats) -> Iterator[tuple[Ints, Floats]]:
    """Stacks that give the same: pixels (n), and RGBA (layers, n, 4) of them, the bottom first.

    `counts`, `rgba`: front first, as `tidied` gives. Pixels of about as many samples share a stack;
    those with fewer have transparent layers on top, which change nothing in any blend order. What
    stack a pixel is in depends on its own samples alone.
    """
    padded = np.concatenate([rgba, np.zeros((1, 4), rgba.dtype)])
    behind = _starts(counts) + counts - 1
    heights = stack_heights(counts)
    for height in np.unique(heights):
        pixels = np.flatnonzero(heights == height)
        from_back = np.arange(height)[:, None]
        index = np.where(from_back < counts[pixels], behind[pixels] - from_back, len(rgba))
        yield pixels, padded[index]


def stack_heights(counts: Ints) -> Ints:
    """The layers of the stack that a pixel with so many samples is in, one of `layers`.

    At least 1, and at most a quarter too many.
    """
    counts = np.maximum(counts, 1)
    step = 2.0 ** (np.floor(np.log2(np.maximum(counts - 1, 1))) - 2)
    return np.where(counts <= _EXACT_COUNTS, counts, np.ceil(counts / step) * step).astype(int)


def _starts(counts: Ints) -> Ints:
    """The first sample of each pixel."""
    return np.cumsum(counts) - counts


def _sorted(samples: DeepSamples) -> tuple[Ints | slice, Floats, Floats, Bools]:
    """The order of all by pixel and depth, fronts and backs in it, and what pixels are to be split.

    These (pixels) have samples that coincide or overlap. A back is not before its front.
    """
    pixel = samples.pixel
    front = samples.front + np.float32(0)  # -0 and 0 are one depth
    back = np.maximum(front, samples.back)
    messy = _untidy(pixel, front, back, len(samples.counts))
    if not messy.any():
        return slice(None), front, back, messy
    order = np.arange(len(pixel))
    found = np.flatnonzero(messy[pixel])
    order[found] = found[_by_depth(pixel[found], front[found], back[found], samples.rgba[found])]
    front, back = front[order], back[order]
    return order, front, back, _untidy(pixel, front, back, len(messy))


def _untidy(pixel: Ints, front: Floats, back: Floats, pixels: int) -> Bools:
    """Which of so many pixels have samples that are not one behind the other as they are."""
    found = np.zeros(pixels, bool)
    found[pixel[1:][~_tidy_pairs(pixel, front, back)]] = True
    return found


def _tidy_pairs(pixel: Ints, front: Floats, back: Floats) -> Bools:
    """(samples - 1): whether each ends before the next one begins, or is of another pixel."""
    in_front = front[:-1] < front[1:]
    in_front &= back[:-1] <= front[1:]
    point_before_volume = (front[:-1] == front[1:]) & (back[:-1] == front[:-1])
    point_before_volume &= back[1:] > front[1:]
    return in_front | point_before_volume | (pixel[:-1] != pixel[1:])


def _keys(pixel: Ints, depth: Floats) -> NDArray[np.uint64]:
    """Numbers sorted as pixel and depth are; the bits of floats are, but for their signs."""
    bits = depth.view(np.uint32)
    rank = np.where(bits >> 31, ~bits, bits | np.uint32(1 << 31))
    return pixel.astype(np.uint64) << np.uint64(32) | rank


def _by_depth(pixel: Ints, front: Floats, back: Floats, rgba: Floats) -> Ints:
    """The order by pixel, front and back; where these are equal, by what else a sample is.

    So the order in which the samples were given has no part in it.
    """
    keys = _keys(pixel, front)
    order = np.argsort(keys)
    keys = keys[order]
    same = keys[1:] == keys[:-1]
    tied = np.flatnonzero(np.append(same, False) | np.insert(same, 0, False))
    among = order[tied]
    blue, green, red, alpha = rgba[among][:, [2, 1, 0, 3]].T
    order[tied] = among[np.lexsort((blue, green, red, alpha, back[among], keys[tied]))]
    return order


@record
class _Pieces:
    """Pieces of samples, cell by cell, from the front: those of a run coincide.

    `sample`, `weights`: (pieces), whose each is, and what that is scaled by, as in `_weights`.
    `pixel`, `lengths`, `transmittance`: (runs).
    """

    sample: Ints
    weights: Floats
    pixel: Ints
    lengths: Ints
    transmittance: Floats


def _merged_pieces(
    pixel: Ints, front: Floats, back: Floats, rgba: Floats, merge: Merge
) -> list[tuple[Ints, Floats]]:
    """Sorted samples of pixels that are not tidy, made so: runs of (pixel (n), RGBA (n, 4))."""
    found = []
    for pieces in _split(pixel, front, back, rgba[:, 3]):
        weighted = (rgba[pieces.sample] * pieces.weights[:, None]).astype(np.float32)
        found.append((pieces.pixel, _one_each(pieces.lengths, weighted, merge)))
    return found


def _in_front(let_through: Floats, pixel: Ints, transmittance: Floats) -> Floats:
    """What is let through in front of each of what follows in pixels, one pixel after the other.

    `let_through` (pixels) is what was before, and is updated. A factor after the other, so that
    what else there is has no part in a pixel's rounding.
    """
    in_front = np.empty(len(pixel))
    first, lengths = _runs(pixel)
    for step in range(lengths.max(initial=0)):
        at = first[lengths > step] + step
        in_front[at] = let_through[pixel[at]]
        let_through[pixel[at]] *= transmittance[at]
    return in_front


def _split(pixel: Ints, front: Floats, back: Floats, alpha: Floats) -> Iterator[_Pieces]:
    """The pieces of sorted samples, split where others begin or end, some cells at a time.

    Depths at which a sample begins or ends are marks. A cell is a mark, where points may be, or
    the space behind it, up to the next one, where parts of volumes may be: cells 2i and 2i + 1.
    """
    n = len(pixel)
    keys = np.concatenate([_keys(pixel, front), _keys(pixel, back)])
    marks, at = np.unique(keys, return_inverse=True)
    first, last = at[:n], at[n:]
    depth = np.empty(len(marks))
    depth[first], depth[last] = front, back
    volume = last > first
    cell = 2 * first + volume
    cells = np.where(volume, last - first, 1)  # cell, cell + 2, ...
    pixel_of_mark = (marks >> np.uint64(32)).astype(np.int64)
    density = _densities(alpha)

    per_cell = np.zeros((len(marks), 2), np.int64)
    per_cell[:, 0] = np.bincount(first[~volume], minlength=len(marks))
    per_cell[:, 1] = np.cumsum(
        np.bincount(first[volume], minlength=len(marks))
        - np.bincount(last[volume], minlength=len(marks))
    )
    pieces_before = np.concatenate([[0], np.cumsum(per_cell)])
    begin = 0
    while begin < 2 * len(marks):
        wanted = pieces_before[begin] + PIECES_AT_ONCE
        end = max(begin + 1, int(np.searchsorted(pieces_before, wanted, side="right")) - 1)
        # The pieces of these cells, of samples that reach them.
        low = np.searchsorted(pixel, pixel_of_mark[begin // 2])
        high = np.searchsorted(cell, end)
        inside = slice(low, high)
        from_step = np.maximum(0, -((cell[inside] - begin) // 2))
        to_step = np.minimum(cells[inside], -((cell[inside] - end) // 2))
        steps = np.maximum(0, to_step - from_step)
        sample = np.repeat(np.arange(low, high), steps)
        step = np.arange(len(sample)) + np.repeat(from_step - _starts(steps), steps)
        of_cell = cell[sample] + 2 * step
        order = np.argsort(of_cell, kind="stable")
        sample, of_cell = sample[order], of_cell[order]
        if len(sample):
            mark = of_cell // 2
            share = np.ones(len(sample))
            parts = of_cell % 2 == 1
            share[parts] = _shares(
                depth[mark[parts]],
                depth[mark[parts] + 1],
                front[sample[parts]].astype(float),
                back[sample[parts]].astype(float),
            )
            first_of_run, lengths = _runs(of_cell)
            weights, transmittance = _weights(lengths, share, density[sample], alpha[sample])
            pixels = pixel_of_mark[of_cell[first_of_run] // 2]
            yield _Pieces(sample, weights, pixels, lengths, transmittance)
        begin = end


def _runs(numbers: Ints) -> tuple[Ints, Ints]:
    """Where runs of equal numbers begin, and how long each is."""
    begin = np.flatnonzero(np.append(True, numbers[1:] != numbers[:-1]))
    return begin, np.diff(begin, append=len(numbers))


def _one_each(lengths: Ints, rgba: Floats, merge: Merge) -> Floats:
    """Each run as one sample: those of one as they are, the others merged."""
    several = lengths > 1
    if not several.any():
        return rgba
    result = np.empty((len(lengths), 4), np.float32)
    of_several = np.repeat(several, lengths)
    result[~several] = rgba[~of_several]
    result[several] = merge(lengths[several], rgba[of_several])
    return result


def _densities(alpha: Floats) -> Floats:
    """u = -log(1 - α) (n) float64, what the medium of a volume absorbs; infinite where opaque."""
    with np.errstate(divide="ignore"):
        return -np.log1p(-alpha.astype(float))


def _shares(near: Floats, far: Floats, front: Floats, back: Floats) -> Floats:
    """What share of a volume's length from `front` to `back` lies between `near` and `far`.

    Of an infinite length all lies at its infinite end, or half at each of two.
    """
    endless = np.isinf(front) | np.isinf(back)
    share = np.empty_like(front)
    whole = ~endless
    share[whole] = (far[whole] - near[whole]) / (back[whole] - front[whole])
    front, back, near, far = front[endless], back[endless], near[endless], far[endless]
    ends = np.isinf(front).astype(float) + np.isinf(back)
    share[endless] = (np.isinf(front) & (near == front)) * 1.0 + (np.isinf(back) & (far == back))
    share[endless] /= ends
    return share


def _weights(lengths: Ints, share: Floats, density: Floats, alpha: Floats) -> tuple[Floats, Floats]:
    """What each piece's sample is scaled by, so that those of a run add up to their merged sample.

    And what each run lets through, 1 - A (runs).

    A share t of a sample has u' = t·u and α' = 1 - exp(-u'), and its colour is scaled by α'/α. A
    run has U = Σ u' and A = 1 - exp(-U), and of its colours A/U · Σ c'·u'/α'. Together that is
    A/U · t·u/α for each, with u/α = 1 where α = 0; its alphas add up to A. Opaque samples
    are averaged, and the others of the run left out. OpenEXR: Interpreting Deep Pixels, Merging
    Overlapping Samples.
    """
    run = np.repeat(np.arange(len(lengths)), lengths)
    opaque = (density == np.inf) & (share > 0)
    absorbed = share * np.where(density == np.inf, 0, density)
    whole = np.bincount(run, weights=absorbed)  # U
    merged_alpha = -np.expm1(-whole)  # A
    ratio = np.divide(merged_alpha, whole, out=np.ones_like(whole), where=whole != 0)
    colored = np.divide(density, alpha, out=np.ones_like(density), where=alpha != 0)  # u/α
    colored[density == np.inf] = 0
    weights = ratio[run] * share * colored
    weights[(np.repeat(lengths, lengths) == 1) & (share == 1)] = 1
    of_run = np.bincount(run, weights=opaque)
    n_opaque = of_run[run]
    some = n_opaque > 0
    weights[some] = opaque[some] / n_opaque[some]
    return weights, np.where(of_run > 0, 0, np.exp(-whole))
