#include "measure.h"

#include "addition.h"
#include "load.h"

#ifndef HPCOMP_LEVEL
#error "compile with -DHPCOMP_LEVEL=<name of this instruction set's measuring>"
#endif

namespace hpcomp {
namespace {

// --- sums ----------------------------------------------------------------------------------------

constexpr float kLargestAddend = 4096;
// Beyond this a colour is left out: its square still is a float.
constexpr float kLargestMeasured = 0x1p60f;

// A value from -4096 to 4096 in units of 2^-24, rounded to even: adding this number leaves the units
// in the low bits of a double.
constexpr double kUnitRounder = 6755399441055744.0;  // 1.5 * 2^52

HPCOMP_INLINE int64_t units_of(float value) {
    const double rounded = double(value) * 0x1p24 + kUnitRounder;
    int64_t bits, zero;
    std::memcpy(&bits, &rounded, sizeof bits);
    std::memcpy(&zero, &kUnitRounder, sizeof zero);
    return bits - zero;
}

HPCOMP_INLINE float within_addends(float v) {
    return v > kLargestAddend ? kLargestAddend : v < -kLargestAddend ? -kLargestAddend : v;
}

// The sum of values from 0 up.
HPCOMP_INLINE int64_t sum_of(const float *values, int n) {
    int64_t sum = 0;
    for (int i = 0; i < n; ++i) sum += units_of(smaller(values[i], kLargestAddend));
    return sum;
}

// --- planes --------------------------------------------------------------------------------------

// Masks are planes of 0 and 1, which multiply and add like any other.
HPCOMP_INLINE float as_mask(bool holds) { return holds ? 1.0f : 0.0f; }

HPCOMP_INLINE int64_t count_of(const float *mask, int n) {
    int count = 0;
    for (int i = 0; i < n; ++i) count += mask[i] != 0;
    return count;
}

HPCOMP_INLINE float part_of(float numerator, float denominator) {
    const float quotient = denominator > 0 ? numerator / denominator : 0.0f;
    return clamped(quotient);
}

// Largest, smallest, and the larger of their sizes.
HPCOMP_INLINE void span_of(float red, float green, float blue, float *largest, float *difference,
                           float *size) {
    *largest = larger(larger(red, green), blue);
    const float smallest = smaller(smaller(red, green), blue);
    *difference = *largest - smallest;
    *size = larger(magnitude(*largest), magnitude(smallest));
}

// --- hue histograms ------------------------------------------------------------------------------

// Pixels that are added at once where they share a bin.
constexpr int kRun = 32;

struct Hues {
    int64_t *bins;    // (bins + 1, kHueColumns)
    int64_t *others;  // (kOthers)
};

// Adds a block of linear, premultiplied colours. The arithmetic is that of `histogram.py`, to the bit.
HPCOMP_INLINE void add_hues(const Rules &rules, const MeasureRules &measures, int n, const float *red,
                            const float *green, const float *blue, const float *alpha, Hues hues) {
    const int bins = measures.bins;
    const float bins_of_sextant = float(bins / 6.0);
    int32_t bin[kBlock];
    int64_t units[kHueColumns][kBlock];
    int nonfinite = 0, transparent = 0, grey = 0;
    Plane has_hue, place;
    for (int i = 0; i < n; ++i) {
        float largest, difference, size;
        span_of(red[i], green[i], blue[i], &largest, &difference, &size);
        const float nothing = red[i] * 0 + green[i] * 0 + blue[i] * 0 + alpha[i] * 0 + difference * 0;
        const int finite = nothing == nothing;
        const int is_grey = (difference == 0) | (difference < measures.achromatic * size);
        const int is_nothing = (alpha[i] <= 0) & (size == 0);
        nonfinite += 1 - finite;
        transparent += finite & is_nothing;
        grey += finite & is_grey & (1 - is_nothing);
        has_hue[i] = float(finite & (1 - is_grey));
    }
    // All ways are computed and chosen from: branches would keep the loop from being vectorised.
    for (int i = 0; i < n; ++i) {
        const float r = red[i], g = green[i], b = blue[i];
        float largest, difference, size;
        span_of(r, g, b, &largest, &difference, &size);
        const float after_red = g - b, after_green = b - r, after_blue = r - g;
        float ahead = largest == g ? after_green : after_blue;
        ahead = largest == r ? after_red : ahead;
        float sextant = largest == g ? 2.0f : 4.0f;
        sextant = largest == r ? 0.0f : sextant;
        place[i] = (sextant + ahead / difference) * bins_of_sextant + 0.5f;
    }
    for (int i = 0; i < n; ++i) place[i] = has_hue[i] != 0 ? place[i] : 0.0f;
    for (int i = 0; i < n; ++i) {
        const int32_t toward_zero = int32_t(place[i]);
        const int32_t down = toward_zero - int32_t(float(toward_zero) > place[i]);
        const int32_t around = down + (bins & (down >> 31));
        bin[i] = around - (bins & ~((around - bins) >> 31));
    }
    for (int i = 0; i < n; ++i) bin[i] = has_hue[i] != 0 ? bin[i] : bins;
    hues.others[kNonfinite] += nonfinite;
    hues.others[kTransparent] += transparent;
    hues.others[kGrey] += grey;
    if (nonfinite + transparent + grey == n) return;
    for (int i = 0; i < n; ++i) {
        const float red_green = red[i] - green[i], blue_green = blue[i] - green[i];
        const float p0 = red_green * rules.to_p[0][0] + blue_green * rules.to_p[0][1];
        const float p1 = red_green * rules.to_p[1][0] + blue_green * rules.to_p[1][1];
        units[kChroma][i] = units_of(smaller(__builtin_sqrtf(p0 * p0 + p1 * p1), kLargestAddend));
        units[kAlpha][i] = units_of(clamped(alpha[i]));
        units[kRed][i] = units_of(within_addends(red[i]));
        units[kGreen][i] = units_of(within_addends(green[i]));
        units[kBlue][i] = units_of(within_addends(blue[i]));
    }
    // Unsigned: the row of those that belong in none takes NaN, too, and may wrap around.
    uint64_t *rows = reinterpret_cast<uint64_t *>(hues.bins);
    for (int begin = 0; begin < n; begin += kRun) {
        const int end = n - begin < kRun ? n : begin + kRun;
        int differs = 0;
        for (int i = begin; i < end; ++i) differs |= bin[i] ^ bin[begin];
        if (!differs) {  // as labels mostly have it
            uint64_t *row = rows + int64_t(bin[begin]) * kHueColumns;
            row[kCount] += uint64_t(end - begin);
            for (int column = kChroma; column <= kBlue; ++column) {
                uint64_t sum = 0;
                for (int i = begin; i < end; ++i) sum += uint64_t(units[column][i]);
                row[column] += sum;
            }
            continue;
        }
        for (int i = begin; i < end; ++i) {
            uint64_t *row = rows + int64_t(bin[i]) * kHueColumns;
            row[kCount] += 1;
            for (int column = kChroma; column <= kBlue; ++column)
                row[column] += uint64_t(units[column][i]);
        }
    }
}

// --- a block -------------------------------------------------------------------------------------

// A block's terms: of the layers and then of the background.
struct Block {
    const Rules &rules;
    const MeasureRules &measures;
    int n;                  // pixels
    int layers;             // the number of the background, too
    float *p, *size;        // (layers + 1, 2, kBlock) and (layers + 1, kBlock): terms and |t|
    float *near;            // (layers + 1, kBlock): whose hue is the result's
    int *active, actives;   // the terms that are anything here
    const float *luminance, *total, *alpha;

    const float *x(int k) const { return p + int64_t(k) * 2 * kBlock; }
    const float *y(int k) const { return x(k) + kBlock; }
};

// Whether the hues of two vectors are no farther apart than the tolerance; true where one has none.
HPCOMP_INLINE bool holds(const MeasureRules &measures, float x1, float y1, float x2, float y2) {
    const float dot = x1 * x2 + y1 * y2, cross = magnitude(x1 * y2 - y1 * x2);
    return cross * measures.cosine <= dot * measures.sine;  // sin(angle - tolerance) <= 0
}

// How the terms stand to a result: its |p|, the sum of the sizes of the terms of its hue, and
// whether that hue is somebody's. Fills `near`.
struct Support {
    Plane size, backing, has_hue;
};

HPCOMP_INLINE void support_of(const Block &block, const float *p0, const float *p1, Support *found) {
    const int n = block.n;
    for (int i = 0; i < n; ++i) {
        found->size[i] = __builtin_sqrtf(p0[i] * p0[i] + p1[i] * p1[i]);
        found->backing[i] = 0;
    }
    for (int a = 0; a < block.actives; ++a) {
        const int k = block.active[a];
        const float *x = block.x(k), *y = block.y(k), *size = block.size + k * kBlock;
        float *near = block.near + k * kBlock;
        for (int i = 0; i < n; ++i) {
            near[i] = as_mask(holds(block.measures, p0[i], p1[i], x[i], y[i]));
            found->backing[i] += near[i] * size[i];
        }
    }
    const float half_step = block.measures.half_step;
    for (int i = 0; i < n; ++i)
        found->has_hue[i] = as_mask((found->size[i] > half_step) & (found->backing[i] > half_step));
}

// The number plus 1 of the layer whose hue survived, 0 for none, and its |t|; the lower of two.
HPCOMP_INLINE void winners(const Block &block, const Support &support, float *winner, float *size) {
    const int n = block.n;
    Plane theirs;
    for (int i = 0; i < n; ++i) winner[i] = size[i] = theirs[i] = 0;
    for (int a = 0; a < block.actives; ++a) {
        const int k = block.active[a];
        if (k == block.layers) continue;
        const float *near = block.near + k * kBlock, *of = block.size + k * kBlock;
        for (int i = 0; i < n; ++i) {
            const float own = near[i] * of[i];
            theirs[i] += own;
            winner[i] = own > size[i] ? float(k + 1) : winner[i];
            size[i] = larger(own, size[i]);
        }
    }
    for (int i = 0; i < n; ++i) {
        const bool there = (support.has_hue[i] != 0) & (theirs[i] > block.measures.half_step);
        winner[i] = there ? winner[i] : 0.0f;
    }
}

// Measures one result of the block; fills `chromatic`.
HPCOMP_INLINE void measure_result(const Block &block, const float *p0, const float *p1,
                                  const Support &support, int64_t *sums, Hues hues, float *chromatic) {
    const Rules &rules = block.rules;
    const float half_step = block.measures.half_step;
    const int n = block.n;
    Plane red, green, blue, foreign, of_near, of_others, values;
    for (int i = 0; i < n; ++i) {
        const float luminance = block.luminance[i];
        red[i] = p0[i] * rules.from_p[0][0] + p1[i] * rules.from_p[0][1] + luminance;
        green[i] = p0[i] * rules.from_p[1][0] + p1[i] * rules.from_p[1][1] + luminance;
        blue[i] = p0[i] * rules.from_p[2][0] + p1[i] * rules.from_p[2][1] + luminance;
        float largest, difference, size;
        span_of(red[i], green[i], blue[i], &largest, &difference, &size);
        const bool has_chroma = support.size[i] > half_step;
        chromatic[i] = as_mask(has_chroma & (difference >= block.measures.achromatic * size));
        foreign[i] = chromatic[i] * (1 - support.has_hue[i]);
        // Those of the surviving hue share what is left of it; what goes beyond is the others'.
        of_near[i] = part_of(support.size[i], support.backing[i]);
        of_others[i] = part_of(support.size[i] - support.backing[i],
                               block.total[i] - support.backing[i]);
    }
    add_hues(rules, block.measures, n, red, green, blue, block.alpha, hues);
    sums[kChromatic] += count_of(chromatic, n);
    sums[kForeign] += count_of(foreign, n);
    for (int i = 0; i < n; ++i) values[i] = chromatic[i] * support.size[i];
    sums[kChromaSum] += sum_of(values, n);
    for (int i = 0; i < n; ++i) values[i] = foreign[i] * support.size[i];
    sums[kForeignChroma] += sum_of(values, n);
    const float *channels[3] = {red, green, blue};
    for (int channel = 0; channel < 3; ++channel) {
        for (int i = 0; i < n; ++i) values[i] = larger(channels[channel][i], 0.0f);
        sums[kLight + channel] += sum_of(values, n);
    }
    for (int a = 0; a < block.actives; ++a) {
        const int k = block.active[a];
        int64_t *own = sums + kResultSums + k * kContributorSums;
        const float *size = block.size + k * kBlock, *near = block.near + k * kBlock;
        int pixels = 0, survived = 0;
        for (int i = 0; i < n; ++i) {
            const bool contributes = size[i] > half_step;
            pixels += contributes;
            survived += contributes & (chromatic[i] * near[i] != 0);
            values[i] = size[i] * (near[i] != 0 ? of_near[i] : of_others[i]);
        }
        own[kPixels] += pixels;
        own[kSurvived] += survived;
        own[kTermSum] += sum_of(size, n);
        own[kKept] += sum_of(values, n);
    }
}

HPCOMP_INLINE void set_provenance(const Block &block, const Support &support, const Provenance &to) {
    const int n = block.n;
    Plane winner, size, x, y, runner_up;
    winners(block, support, winner, size);
    for (int i = 0; i < n; ++i) x[i] = y[i] = runner_up[i] = 0;
    for (int a = 0; a < block.actives; ++a) {
        const int k = block.active[a];
        const float *px = block.x(k), *py = block.y(k);
        for (int i = 0; i < n; ++i) {
            const bool is_winner = winner[i] == float(k + 1);
            x[i] = is_winner ? px[i] : x[i];
            y[i] = is_winner ? py[i] : y[i];
        }
    }
    for (int a = 0; a < block.actives; ++a) {
        const int k = block.active[a];
        const float *px = block.x(k), *py = block.y(k), *of = block.size + k * kBlock;
        for (int i = 0; i < n; ++i) {
            const float rival = holds(block.measures, x[i], y[i], px[i], py[i]) ? 0.0f : of[i];
            runner_up[i] = larger(rival, runner_up[i]);
        }
    }
    for (int i = 0; i < n; ++i) {
        const bool there = winner[i] != 0;
        to.layer[i] = uint32_t(winner[i]);
        to.grey[i] = block.total[i] > 0 ? 1 - part_of(support.size[i], block.total[i]) : 0.0f;
        to.margin[i] = there ? 1 - runner_up[i] / (there ? size[i] : 1.0f) : 0.0f;
    }
}

// The layers' terms added one by one, upwards or downwards, the background last.
HPCOMP_INLINE void fold(const Block &block, bool upward, float *p0, float *p1) {
    for (int i = 0; i < block.n; ++i) p0[i] = p1[i] = 0;
    int background = 0;
    for (int a = 0; a < block.actives; ++a) {
        const int k = block.active[upward ? a : block.actives - 1 - a];
        if (k == block.layers) {
            background = 1;
            continue;
        }
        add(block.rules, block.n, p0, p1, block.x(k), block.y(k));
    }
    if (background) add(block.rules, block.n, p0, p1, block.x(block.layers), block.y(block.layers));
}

// The chroma of the stack, in its own order.
HPCOMP_INLINE void reduce(const Block &block, float *scratch, float *p0, float *p1) {
    const Order order = block.rules.order;
    if (order == Order::kBottomUp || order == Order::kFrontToBack) {
        fold(block, order == Order::kBottomUp, p0, p1);
        return;
    }
    const int count = block.layers;
    float *p = scratch, *pairs = scratch + int64_t(count) * 2 * kBlock;
    std::memcpy(p, block.p, size_t(count) * 2 * sizeof(Plane));
    reduce_terms(block.rules, p, count, block.n, pairs,
                 reinterpret_cast<int *>(pairs + pair_floats(count)));
    std::memcpy(p0, p, sizeof(Plane));
    std::memcpy(p1, p + kBlock, sizeof(Plane));
    if (block.actives && block.active[block.actives - 1] == count)
        add(block.rules, block.n, p0, p1, block.x(count), block.y(count));
}

HPCOMP_INLINE bool is_nothing(const float *red, const float *green, const float *blue,
                              const float *alpha, int n) {
    uint32_t any = 0;
    for (int i = 0; i < n; ++i)
        any |= bits_of(red[i]) | bits_of(green[i]) | bits_of(blue[i]) | bits_of(alpha[i]);
    return (any & 0x7fffffffu) == 0;
}

// `scratch` holds `measure_floats` of them.
void measure(const Rules &rules, const MeasureRules &measures, const Layer *layers, int count,
             int width, int height, float *scratch, Measures *found) {
    const int64_t terms = count + 1;
    float *p = scratch, *luminance = p + terms * 2 * kBlock, *f_a = luminance + terms * kBlock;
    float *f_b = f_a + terms * kBlock, *size = f_b + terms * kBlock, *near = size + terms * kBlock;
    int *active = reinterpret_cast<int *>(near + terms * kBlock);
    float *reducing = near + 2 * terms * kBlock;
    const int64_t hue_rows = int64_t(measures.bins + 1) * kHueColumns;
    const auto hues_of = [&](int k) {
        return Hues{found->hues + k * hue_rows, found->others + k * kOthers};
    };
    for (int y = 0; y < height; ++y) {
        for (int x = 0; x < width; x += kBlock) {
            const int n = width - x < kBlock ? width - x : kBlock;
            Plane alpha, sum, total, known;
            for (int k = 0; k < count; ++k) {
                Plane red, green, blue, own_alpha;
                float *p0 = p + int64_t(k) * 2 * kBlock;
                // Lanes beyond the row take part in the reduction, and must be harmless.
                std::memset(p0, 0, 2 * sizeof(Plane));
                load(layers[k], x, y, n, red, green, blue, own_alpha);
                if (is_nothing(red, green, blue, own_alpha, n)) {
                    hues_of(k).others[kTransparent] += n;
                    std::memset(luminance + k * kBlock, 0, sizeof(Plane));
                } else {
                    add_hues(rules, measures, n, red, green, blue, own_alpha, hues_of(k));
                    to_terms(rules, n, red, green, blue, luminance + k * kBlock, p0, p0 + kBlock);
                }
                factors(layers[k], k, n, own_alpha, f_a + k * kBlock, f_b + k * kBlock, alpha);
            }
            weigh(count, n, f_a, f_b, luminance, p, sum);
            float *below = p + int64_t(count) * 2 * kBlock;
            std::memset(below, 0, 2 * sizeof(Plane));
            std::memset(luminance + count * kBlock, 0, sizeof(Plane));
            if (rules.has_background) {
                for (int i = 0; i < n; ++i) {
                    const float uncovered = 1 - alpha[i];
                    luminance[count * kBlock + i] = uncovered * rules.background_luminance;
                    sum[i] += luminance[count * kBlock + i];
                    below[i] = uncovered * rules.background_p[0];
                    below[kBlock + i] = uncovered * rules.background_p[1];
                    alpha[i] = 1;
                }
            }
            int unknown = 0;
            for (int i = 0; i < n; ++i) known[i] = 1;
            for (int k = 0; k <= count; ++k) {
                const float *p0 = p + int64_t(k) * 2 * kBlock, *of = luminance + k * kBlock;
                for (int i = 0; i < n; ++i) {
                    const bool measurable = (magnitude(of[i]) < kLargestMeasured) &
                                            (magnitude(p0[i]) < kLargestMeasured) &
                                            (magnitude(p0[kBlock + i]) < kLargestMeasured);
                    known[i] = measurable ? known[i] : 0.0f;
                }
            }
            for (int i = 0; i < n; ++i) unknown += known[i] == 0;
            if (unknown) {
                found->unmeasured += unknown;
                for (int k = 0; k <= count; ++k)
                    for (int i = 0; i < n; ++i)
                        if (known[i] == 0) p[int64_t(k) * 2 * kBlock + i] = p[int64_t(k) * 2 * kBlock + kBlock + i] = 0;
                for (int i = 0; i < n; ++i) sum[i] = known[i] == 0 ? 0.0f : sum[i];
            }
            Block block{rules, measures, n, count, p, size, near, active, 0, sum, total, alpha};
            for (int i = 0; i < n; ++i) total[i] = 0;
            for (int k = 0; k <= count; ++k) {
                const float *p0 = block.x(k), *p1 = block.y(k);
                float *of = size + k * kBlock;
                uint32_t any = 0;
                for (int i = 0; i < n; ++i) {
                    of[i] = __builtin_sqrtf(p0[i] * p0[i] + p1[i] * p1[i]);
                    total[i] += of[i];
                    // Not of its size: the square of what is very small is 0.
                    any |= bits_of(p0[i]) | bits_of(p1[i]);
                }
                if (any & 0x7fffffffu) active[block.actives++] = k;
            }

            const int64_t result_sums = kResultSums + kContributorSums * terms;
            Plane p0, p1, plain0, plain1, chromatic, ignored;
            Support support;
            // What cannot be measured is still a pixel of the histograms.
            const auto mark_unknown = [&](float *plane) {
                for (int i = 0; i < n; ++i)
                    if (known[i] == 0) plane[i] = float_of(0x7fc00000u);
            };
            for (int i = 0; i < n; ++i) plain0[i] = plain1[i] = 0;
            for (int a = 0; a < block.actives; ++a) {
                const float *px = block.x(active[a]), *py = block.y(active[a]);
                for (int i = 0; i < n; ++i) plain0[i] += px[i], plain1[i] += py[i];
            }
            if (unknown) mark_unknown(alpha);
            support_of(block, plain0, plain1, &support);
            measure_result(block, plain0, plain1, support, found->results + result_sums,
                           hues_of(count + 1), ignored);

            reduce(block, reducing, p0, p1);
            support_of(block, p0, p1, &support);
            measure_result(block, p0, p1, support, found->results, hues_of(count), chromatic);
            if (found->provenance.layer != nullptr) {
                const int64_t at = int64_t(y) * width + x;
                const Provenance &all = found->provenance;
                set_provenance(block, support, {all.layer + at, all.grey + at, all.margin + at});
            }
            const bool many = block.actives > 2;  // two terms have no order
            if (measures.depends_on_order && many) {
                Plane upward, downward;
                const auto survivors = [&](Order order, float *winner) {
                    Plane size_of_winner, q0, q1;
                    if (rules.order == order) {
                        winners(block, support, winner, size_of_winner);
                        return;
                    }
                    Support other;
                    fold(block, order == Order::kBottomUp, q0, q1);
                    support_of(block, q0, q1, &other);
                    winners(block, other, winner, size_of_winner);
                };
                // The one that is at hand first: the other overwrites who is near.
                if (rules.order == Order::kFrontToBack) {
                    survivors(Order::kFrontToBack, downward);
                    survivors(Order::kBottomUp, upward);
                } else {
                    survivors(Order::kBottomUp, upward);
                    survivors(Order::kFrontToBack, downward);
                }
                int sensitive = 0;
                for (int i = 0; i < n; ++i)
                    sensitive += (chromatic[i] != 0) & (upward[i] != downward[i]);
                found->order_sensitive += sensitive;
            }
        }
    }
}

}  // namespace

#define HPCOMP_JOINED(prefix, level) prefix##level
#define HPCOMP_SYMBOL(prefix, level) HPCOMP_JOINED(prefix, level)
extern const Measuring HPCOMP_SYMBOL(measuring_, HPCOMP_LEVEL);
const Measuring HPCOMP_SYMBOL(measuring_, HPCOMP_LEVEL) = {measure};

}  // namespace hpcomp
