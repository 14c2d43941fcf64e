// Hue histograms of planes of pixels. The arithmetic is that of `histogram.py`, to the bit.

#pragma once

#include "measure.h"
#include "sums.h"

namespace hpcomp {
namespace {

struct Hues {
    int64_t *bins;        // (bins, kHueColumns)
    OtherPixels *others;
};

// Largest, their difference, and the larger of their sizes.
HPCOMP_INLINE void span_of(float red, float green, float blue, float *largest, float *difference,
                           float *size) {
    *largest = larger(larger(red, green), blue);
    const float smallest = smaller(smaller(red, green), blue);
    *difference = *largest - smallest;
    *size = larger(magnitude(*largest), magnitude(smallest));
}

// The bin of each pixel, `bins` where it belongs in none; those are counted. All ways are computed
// and chosen from, some by masks: branches would keep the loop from being vectorised.
template <bool kFinite>
HPCOMP_INLINE void find_bins(const MeasureRules &measures, int n, ConstRow red, ConstRow green,
                             ConstRow blue, ConstRow alpha, int32_t *bin, OtherPixels *others) {
    const int bins = measures.bins;
    const float bins_of_sextant = float(bins / 6.0), achromatic = measures.achromatic;
    int nonfinite = 0, transparent = 0, grey = 0;
    for (int i = 0; i < n; ++i) {
        const float r = red[i], g = green[i], b = blue[i];
        float largest, difference, size;
        span_of(r, g, b, &largest, &difference, &size);
        int finite = 1;
        if (!kFinite) {
            const float nothing = r * 0 + g * 0 + b * 0 + alpha[i] * 0 + difference * 0;
            finite = nothing == nothing;
            nonfinite += 1 - finite;
        }
        const int is_grey = (difference == 0) | (difference < achromatic * size);
        const int is_nothing = (alpha[i] <= 0) & (size == 0);
        transparent += finite & is_nothing;
        grey += finite & is_grey & (1 - is_nothing);
        const uint32_t has_hue = 0u - uint32_t(finite & (1 - is_grey));

        float ahead = largest == g ? b - r : r - g;
        ahead = largest == r ? g - b : ahead;
        float sextant = largest == g ? 2.0f : 4.0f;
        sextant = largest == r ? 0.0f : sextant;
        const float anywhere = (sextant + ahead / difference) * bins_of_sextant + 0.5f;
        const float place = float_of(bits_of(anywhere) & has_hue);
        const int32_t toward_zero = int32_t(place);
        const int32_t down = toward_zero - int32_t(float(toward_zero) > place);
        const int32_t around = down + (bins & (down >> 31));
        const int32_t found = around - (bins & ~((around - bins) >> 31));
        bin[i] = int32_t((uint32_t(found) & has_hue) | (uint32_t(bins) & ~has_hue));
    }
    others->nonfinite += nonfinite;
    others->transparent += transparent;
    others->grey += grey;
}

// Pixels that are added at once where they share a bin; sums of so many small addends fit 32 bits.
constexpr int kRun = 32;

// The units of a pixel's addend, and of those of a run.
template <bool kSmall> HPCOMP_INLINE int64_t addend_of(float value) {
    return kSmall ? small_units_of(value) : units_of(within_addends(value));
}
template <bool kSmall> HPCOMP_INLINE int64_t sum_of_run(ConstRow values, int begin, int end) {
    int64_t total = 0;
    int32_t small_total = 0;
    for (int i = begin; i < end; ++i) {
        if (kSmall)
            small_total += small_units_of(values[i]);
        else
            total += units_of(within_addends(values[i]));
    }
    return total + small_total;
}

// `columns`: what is summed, from `kChroma` on.
template <bool kSmall>
HPCOMP_INLINE void add_to_bins(int bins, int n, const int32_t *bin, const float *const *columns,
                               int64_t *rows) {
    for (int begin = 0; begin < n; begin += kRun) {
        const int end = n - begin < kRun ? n : begin + kRun;
        int differs = 0;
        for (int i = begin; i < end; ++i) differs |= bin[i] ^ bin[begin];
        if (!differs) {  // as labels mostly have it
            if (bin[begin] == bins) continue;
            int64_t *row = rows + int64_t(bin[begin]) * kHueColumns;
            row[kCount] += end - begin;
            for (int column = kChroma; column <= kBlue; ++column)
                row[column] += sum_of_run<kSmall>(columns[column - kChroma], begin, end);
            continue;
        }
        for (int i = begin; i < end; ++i) {
            if (bin[i] == bins) continue;
            int64_t *row = rows + int64_t(bin[i]) * kHueColumns;
            row[kCount] += 1;
            for (int column = kChroma; column <= kBlue; ++column)
                row[column] += addend_of<kSmall>(columns[column - kChroma][i]);
        }
    }
}

// Adds a block of linear, premultiplied colours, their alpha in [0, 1] or NaN, and their |p|.
// Returns whether all are small addends.
bool add_hues(const MeasureRules &measures, int n, ConstRow red, ConstRow green, ConstRow blue,
              ConstRow alpha, ConstRow chroma, Hues hues) {
    int32_t bin[kBlock];
    const float *columns[] = {chroma, alpha, red, green, blue};
    const bool small = all_small(n, red, green, blue, alpha, chroma);
    if (small) {
        find_bins<true>(measures, n, red, green, blue, alpha, bin, hues.others);
        add_to_bins<true>(measures.bins, n, bin, columns, hues.bins);
    } else {
        find_bins<false>(measures, n, red, green, blue, alpha, bin, hues.others);
        add_to_bins<false>(measures.bins, n, bin, columns, hues.bins);
    }
    return small;
}

}  // namespace
}  // namespace hpcomp
