#include "addition.h"
#include "load.h"

#ifndef HPCOMP_LEVEL
#error "compile with -DHPCOMP_LEVEL=<name of this instruction set's engine>"
#endif

namespace hpcomp {
namespace {

// --- folds ---------------------------------------------------------------------------------------

// lo and hi of the stack so far, on which a term of bounds `lo` and `hi` comes.
HPCOMP_INLINE void bound(int n, const float *f_a, const float *f_b, const float *lo, const float *hi,
                         const State &at) {
    for (int i = 0; i < n; ++i) {
        at.lo[i] = f_a[i] * lo[i] + f_b[i] * at.lo[i];
        at.hi[i] = f_a[i] * hi[i] + f_b[i] * at.hi[i];
    }
}

HPCOMP_INLINE void under_all(const Rules &rules, int n, ConstRow luminance, ConstRow p0, ConstRow p1,
                             ConstRow alpha, const float *lo, const float *hi, const State &at) {
    Row transmittance = at.transmittance, sum = at.luminance, alpha_sum = at.alpha;
    Plane q0, q1;
    if (rules.maps != Maps::kLinear) {
        for (int i = 0; i < n; ++i) {
            at.lo[i] += transmittance[i] * lo[i];
            at.hi[i] += transmittance[i] * hi[i];
        }
    }
    for (int i = 0; i < n; ++i) {
        const float weight = transmittance[i];
        sum[i] += weight * luminance[i];  // [R1]
        q0[i] = weight * p0[i];
        q1[i] = weight * p1[i];
        alpha_sum[i] = at_most_one(alpha_sum[i] + weight * alpha[i]);
        transmittance[i] *= 1 - alpha[i];
    }
    add(rules, n, at.p0, at.p1, q0, q1, true);
}

HPCOMP_INLINE void above_all(const Rules &rules, const Layer &layer, int n, ConstRow luminance,
                             ConstRow p0, ConstRow p1, ConstRow alpha, const float *lo, const float *hi,
                             const State &at) {
    Plane f_a, f_b, q0, q1;
    Row sum = at.luminance, alpha_sum = at.alpha, below0 = at.p0, below1 = at.p1;
    factor(layer.factor_a, at.alpha, n, f_a);
    factor(layer.factor_b, alpha, n, f_b);
    if (rules.maps != Maps::kLinear) bound(n, f_a, f_b, lo, hi, at);
    for (int i = 0; i < n; ++i) {
        sum[i] = f_a[i] * luminance[i] + f_b[i] * sum[i];  // [R1]
        alpha_sum[i] = at_most_one(f_a[i] * alpha[i] + f_b[i] * alpha_sum[i]);
        below0[i] *= f_b[i];
        below1[i] *= f_b[i];
        q0[i] = f_a[i] * p0[i];
        q1[i] = f_a[i] * p1[i];
    }
    add(rules, n, at.p0, at.p1, q0, q1, layer.behind);  // Eq. 2 with (+)
}

HPCOMP_INLINE State state_at(const State &state, int64_t pixel) {
    return {state.luminance + pixel, state.p0 + pixel, state.p1 + pixel, state.alpha + pixel,
            state.transmittance ? state.transmittance + pixel : nullptr,
            state.lo ? state.lo + pixel : nullptr, state.hi ? state.hi + pixel : nullptr};
}

void add_layers(const Rules &rules, const Layer *layers, const int *numbers, int count, int width,
                int height, const State &state, int64_t *nonfinite, const Observer *observer) {
    for (int y = 0; y < height; ++y) {
        for (int x = 0; x < width; x += kBlock) {
            const int n = width - x < kBlock ? width - x : kBlock;
            const State at = state_at(state, int64_t(y) * width + x);
            for (int k = 0; k < count; ++k) {
                Plane red, green, blue, luminance, p0, p1, alpha, lo, hi;
                nonfinite[k] += load_term(rules, layers[k], x, y, n, red, green, blue, luminance, p0,
                                          p1, alpha, lo, hi);
                if (observer)
                    observer->term(observer->self, numbers[k], n, red, green, blue, alpha, luminance,
                                   p0, p1);
                if (rules.order == Order::kFrontToBack) {
                    under_all(rules, n, luminance, p0, p1, alpha, lo, hi, at);
                } else if (numbers[k] == 0) {
                    std::memcpy(at.luminance, luminance, n * sizeof(float));
                    std::memcpy(at.p0, p0, n * sizeof(float));
                    std::memcpy(at.p1, p1, n * sizeof(float));
                    std::memcpy(at.alpha, alpha, n * sizeof(float));
                    if (rules.maps != Maps::kLinear) {
                        std::memcpy(at.lo, lo, n * sizeof(float));
                        std::memcpy(at.hi, hi, n * sizeof(float));
                    }
                } else {
                    above_all(rules, layers[k], n, luminance, p0, p1, alpha, lo, hi, at);
                }
            }
            if (observer) observer->block(observer->self, x, y, n);
        }
    }
}

// --- reductions of all layers --------------------------------------------------------------------

// `scratch` holds `scratch_floats` of them.
void reduce_layers(const Rules &rules, const Layer *layers, int count, int width, int height,
                   const State &state, float *scratch, int64_t *nonfinite, const Observer *observer) {
    float *p = scratch;                                  // (count, 2, kBlock)
    float *luminance = p + int64_t(count) * 2 * kBlock;  // (count, kBlock), then the factors:
    float *f_a = luminance + int64_t(count) * kBlock, *f_b = f_a + int64_t(count) * kBlock;
    for (int y = 0; y < height; ++y) {
        for (int x = 0; x < width; x += kBlock) {
            const int n = width - x < kBlock ? width - x : kBlock;
            const State at = state_at(state, int64_t(y) * width + x);
            for (int k = 0; k < count; ++k) {
                Plane red, green, blue, alpha, lo, hi;
                float *p0 = p + int64_t(k) * 2 * kBlock, *of = luminance + k * kBlock;
                float *layer_a = f_a + k * kBlock, *layer_b = f_b + k * kBlock;
                // Lanes beyond the row take part in the reduction, and must be harmless.
                std::memset(p0, 0, 2 * sizeof(Plane));
                nonfinite[k] += load_term(rules, layers[k], x, y, n, red, green, blue, of, p0,
                                          p0 + kBlock, alpha, lo, hi);
                if (observer)
                    observer->term(observer->self, k, n, red, green, blue, alpha, of, p0, p0 + kBlock);
                factors(layers[k], k, n, alpha, layer_a, layer_b, at.alpha);
                if (rules.maps == Maps::kLinear) continue;
                if (k == 0) {
                    // Under it was nothing, of which the planes know not.
                    std::memset(at.lo, 0, n * sizeof(float));
                    std::memset(at.hi, 0, n * sizeof(float));
                }
                bound(n, layer_a, layer_b, lo, hi, at);
            }
            weigh(count, n, f_a, f_b, luminance, p, at.luminance);
            reduce_terms(rules, p, count, n, scratch + term_floats(count));
            std::memcpy(at.p0, p, n * sizeof(float));
            std::memcpy(at.p1, p + kBlock, n * sizeof(float));
            if (observer) observer->block(observer->self, x, y, n);
        }
    }
}

// --- planes to samples ---------------------------------------------------------------------------

// The same luminance and hue with every channel in [0, 1]: chroma shrinks, white and black are ends.
void into_gamut(const double *weights, float *rgb) {
    double luminance = weights[0] * rgb[0] + weights[1] * rgb[1] + weights[2] * rgb[2];
    luminance = luminance != luminance ? 1 : luminance < 0 ? 0 : luminance > 1 ? 1 : luminance;
    double fits = 1;
    for (int c = 0; c < 3; ++c) {
        const double difference = rgb[c] - luminance;
        if (difference * 0 != 0) fits = 0;  // an infinite channel leaves grey
        const double room = difference > 0 ? 1 - luminance : luminance;
        const double size = difference < 0 ? -difference : difference;
        if (size > room && room / size < fits) fits = room / size;
    }
    for (int c = 0; c < 3; ++c)
        rgb[c] = float(fits == 0 ? luminance : luminance + fits * (rgb[c] - luminance));
}

HPCOMP_INLINE uint32_t code_of(const Output &out, float linear) {
    // Never NaN, and never beyond the last threshold, which is infinite.
    const float inside = linear > out.smallest ? smaller(linear, 1.0f) : out.smallest;
    uint32_t code = out.first_code[(bits_of(inside) - bits_of(out.smallest)) >> (23 - out.bucket_bits)];
    while (inside >= out.thresholds[code]) ++code;
    return code;
}

template <class Code>
HPCOMP_INLINE void store_codes(int n, float *red, float *green, float *blue,
                               float *alpha, const Output &out, Code *to, Losses *losses) {
    constexpr double largest = Code(~Code(0));
    constexpr double kRounder = 6755399441055744.0;  // 1.5 * 2^52: adding it rounds to an integer
    int unknown = 0, lost = 0, outside = 0;
    alignas(64) uint32_t alpha_code[kBlock];
    for (int i = 0; i < n; ++i) {
        unknown += (red[i] != red[i]) | (green[i] != green[i]) | (blue[i] != blue[i]) |
                   (alpha[i] != alpha[i]);
    }
    if (unknown) {
        for (int i = 0; i < n; ++i)
            if (red[i] != red[i] || green[i] != green[i] || blue[i] != blue[i] || alpha[i] != alpha[i])
                red[i] = green[i] = blue[i] = alpha[i] = 0;
        losses->not_a_number += unknown;
    }
    for (int i = 0; i < n; ++i) {
        const double code = (double(alpha[i]) * largest + kRounder) - kRounder;
        alpha_code[i] = uint32_t(int32_t(code));
        const float brightest = larger(larger(magnitude(red[i]), magnitude(green[i])), magnitude(blue[i]));
        const bool visible = code > 0;
        lost += !visible & (brightest - alpha[i] > out.darkest);
        const float divisor = visible ? alpha[i] : 1.0f;
        red[i] = visible ? red[i] / divisor : 0.0f;
        green[i] = visible ? green[i] / divisor : 0.0f;
        blue[i] = visible ? blue[i] / divisor : 0.0f;
        outside += (red[i] < out.lowest) | (red[i] > out.highest) | (green[i] < out.lowest) |
                   (green[i] > out.highest) | (blue[i] < out.lowest) | (blue[i] > out.highest);
    }
    losses->light_without_alpha += lost;
    losses->out_of_gamut += outside;
    if (outside) {
        for (int i = 0; i < n; ++i) {
            float rgb[3] = {red[i], green[i], blue[i]};
            bool out_of_gamut = false;
            for (const float v : rgb) out_of_gamut |= v < out.lowest || v > out.highest;
            if (!out_of_gamut) continue;
            into_gamut(out.weights, rgb);
            red[i] = rgb[0], green[i] = rgb[1], blue[i] = rgb[2];
        }
    }
    for (int i = 0; i < n; ++i) {
        to[4 * i] = Code(code_of(out, red[i]));
        to[4 * i + 1] = Code(code_of(out, green[i]));
        to[4 * i + 2] = Code(code_of(out, blue[i]));
        to[4 * i + 3] = Code(alpha_code[i]);
    }
}

constexpr float kLargestHalf = 65504;

HPCOMP_INLINE bool beyond_half(float v) {
    const float size = magnitude(v);
    return size > kLargestHalf && size < float_of(0x7f800000u);
}

HPCOMP_INLINE float in_half_range(float v) {
    return beyond_half(v) ? (v < 0 ? -kLargestHalf : kLargestHalf) : v;
}

void finish(const Rules &rules, int64_t pixels, const State &state, const Output &out, Losses *losses) {
    for (int64_t begin = 0; begin < pixels; begin += kBlock) {
        const int n = pixels - begin < kBlock ? int(pixels - begin) : kBlock;
        const State at = state_at(state, begin);
        Plane luminance, p0, p1, alpha, red, green, blue, lo, hi;
        for (int i = 0; i < n; ++i) {
            luminance[i] = at.luminance[i];
            p0[i] = at.p0[i];
            p1[i] = at.p1[i];
            alpha[i] = at.alpha[i];
        }
        if (rules.maps != Maps::kLinear) {
            const float below = rules.background_bounds[0], above = rules.background_bounds[1];
            for (int i = 0; i < n; ++i) {
                const float uncovered = rules.has_background ? 1 - alpha[i] : 0.0f;
                lo[i] = at.lo[i] + uncovered * below;
                hi[i] = at.hi[i] + uncovered * above;
            }
        }
        if (rules.has_background) {
            Plane q0, q1;
            for (int i = 0; i < n; ++i) {
                const float uncovered = 1 - alpha[i];
                luminance[i] += uncovered * rules.background_luminance;
                q0[i] = uncovered * rules.background_p[0];
                q1[i] = uncovered * rules.background_p[1];
                alpha[i] = 1;
            }
            add(rules, n, p0, p1, q0, q1, true);
        }
        if (rules.maps != Maps::kLinear) {
            from_p(rules, n, luminance, p0, p1, lo, hi, red, green, blue);
        } else {
            for (int i = 0; i < n; ++i)
                linear_from_p(rules, luminance[i], p0[i], p1[i], &red[i], &green[i], &blue[i]);
        }
        if (rules.gain != 1) {
            for (int i = 0; i < n; ++i) {
                red[i] *= rules.gain;
                green[i] *= rules.gain;
                blue[i] *= rules.gain;
            }
        }
        if (out.has_matrix) convert(out.matrix, n, red, green, blue);
        switch (out.type) {
        case Sample::kU8:
            store_codes(n, red, green, blue, alpha, out,
                        static_cast<uint8_t *>(out.samples) + 4 * begin, losses);
            break;
        case Sample::kU16:
            store_codes(n, red, green, blue, alpha, out,
                        static_cast<uint16_t *>(out.samples) + 4 * begin, losses);
            break;
        case Sample::kHalf: {
            uint16_t *to = static_cast<uint16_t *>(out.samples) + 4 * begin;
            int beyond = 0;
            for (int i = 0; i < n; ++i) {
                beyond += beyond_half(red[i]) | beyond_half(green[i]) | beyond_half(blue[i]);
                to[4 * i] = to_half(in_half_range(red[i]));
                to[4 * i + 1] = to_half(in_half_range(green[i]));
                to[4 * i + 2] = to_half(in_half_range(blue[i]));
                to[4 * i + 3] = to_half(alpha[i]);
            }
            losses->beyond_half += beyond;
            break;
        }
        case Sample::kFloat: {
            float *to = static_cast<float *>(out.samples) + 4 * begin;
            for (int i = 0; i < n; ++i) {
                to[4 * i] = one_nan(red[i]);
                to[4 * i + 1] = one_nan(green[i]);
                to[4 * i + 2] = one_nan(blue[i]);
                to[4 * i + 3] = one_nan(alpha[i]);
            }
        }
        }
    }
}

}  // namespace

#define HPCOMP_JOINED(prefix, level) prefix##level
#define HPCOMP_SYMBOL(prefix, level) HPCOMP_JOINED(prefix, level)
extern const Engine HPCOMP_SYMBOL(engine_, HPCOMP_LEVEL);
const Engine HPCOMP_SYMBOL(engine_, HPCOMP_LEVEL) = {add_layers, reduce_layers, finish};

}  // namespace hpcomp
