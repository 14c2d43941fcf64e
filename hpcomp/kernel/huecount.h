// Hue histograms of planes of pixels. The arithmetic is that of `histogram.py`, to the bit.

#pragma once

#include "measure.h"
#include "sums.h"

namespace hpcomp {
namespace {

struct Hues {
    int64_t *bins;    // (bins, kHueColumns)
    int64_t *others;  // (kOthers)
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
                             ConstRow blue, ConstRow alpha, int32_t *bin, int64_t *others) {
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
    others[kNonfinite] += nonfinite;
    others[kTransparent] += transparent;
    others[kGrey] += grey;
}

// Pixels that are added at once where they share a bin.
constexpr int kRun = 32;

template <class Units>
HPCOMP_INLINE void add_to_bins(int bins, int n, const int32_t *bin, const Units (*units)[kBlock],
                               int64_t *rows) {
    for (int begin = 0; begin < n;) {
        const int32_t first = bin[begin];
        int end = begin, differs = 0;
        while (end < n && !differs) {  // labels mostly have one hue for long
            const int stop = n - end < kRun ? n : end + kRun;
            for (int i = end; i < stop; ++i) differs |= bin[i] ^ first;
            end = differs ? end : stop;
        }
        if (end > begin) {
            if (first != bins) {
                int64_t *row = rows + int64_t(first) * kHueColumns;
                row[kCount] += end - begin;
                for (int column = kChroma; column <= kBlue; ++column)
                    row[column] += sum_of_run(units[column], begin, end);
            }
            begin = end;
            continue;
        }
        const int stop = n - begin < kRun ? n : begin + kRun;
        for (; begin < stop; ++begin) {
            if (bin[begin] == bins) continue;
            int64_t *row = rows + int64_t(bin[begin]) * kHueColumns;
            row[kCount] += 1;
            for (int column = kChroma; column <= kBlue; ++column) row[column] += units[column][begin];
        }
    }
}

// Adds a block of linear, premultiplied colours and their |p|. Returns whether all are small addends.
bool add_hues(const MeasureRules &measures, int n, ConstRow red, ConstRow green, ConstRow blue,
              ConstRow alpha, ConstRow chroma, Hues hues) {
    int32_t bin[kBlock];
    if (all_small(n, red, green, blue, alpha, chroma)) {
        find_bins<true>(measures, n, red, green, blue, alpha, bin, hues.others);
        int32_t units[kBlue + 1][kBlock];
        for (int i = 0; i < n; ++i) {
            units[kChroma][i] = small_units_of(chroma[i]);
            units[kAlpha][i] = small_units_of(clamped(alpha[i]));
            units[kRed][i] = small_units_of(red[i]);
            units[kGreen][i] = small_units_of(green[i]);
            units[kBlue][i] = small_units_of(blue[i]);
        }
        add_to_bins(measures.bins, n, bin, units, hues.bins);
        return true;
    }
    find_bins<false>(measures, n, red, green, blue, alpha, bin, hues.others);
    int64_t units[kBlue + 1][kBlock];
    for (int i = 0; i < n; ++i) {
        units[kChroma][i] = units_of(smaller(chroma[i], kLargestAddend));
        units[kAlpha][i] = units_of(clamped(alpha[i]));
        units[kRed][i] = units_of(within_addends(red[i]));
        units[kGreen][i] = units_of(within_addends(green[i]));
        units[kBlue][i] = units_of(within_addends(blue[i]));
    }
    add_to_bins(measures.bins, n, bin, units, hues.bins);
    return false;
}

}  // namespace
}  // namespace hpcomp
