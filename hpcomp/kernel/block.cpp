#include "addition.h"
#include "load.h"
#include "weaving.h"

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

HPCOMP_INLINE void copy(int n, const Light &from, const Light &to) {
    const float *const sources[6] = {from.luminance, from.p0, from.p1, from.red, from.green, from.blue};
    float *const targets[6] = {to.luminance, to.p0, to.p1, to.red, to.green, to.blue};
    for (int plane = 0; plane < 6; ++plane) std::memcpy(targets[plane], sources[plane], n * sizeof(float));
    if (from.strength) std::memcpy(to.strength, from.strength, n * sizeof(float));
}

HPCOMP_INLINE void under_all(const Rules &rules, int n, const Light &term, ConstRow alpha, const float *lo,
                             const float *hi, const State &at) {
    Plane whole;
    Row transmittance = at.transmittance, alpha_sum = at.alpha;
    if (rules.bounded) {
        for (int i = 0; i < n; ++i) {
            at.lo[i] += transmittance[i] * lo[i];
            at.hi[i] += transmittance[i] * hi[i];
        }
    }
    for (int i = 0; i < n; ++i) whole[i] = 1;
    add(rules, n, at.light, whole, term, transmittance, true);
    for (int i = 0; i < n; ++i) {
        alpha_sum[i] = at_most_one(alpha_sum[i] + transmittance[i] * alpha[i]);
        transmittance[i] *= 1 - alpha[i];
    }
}

HPCOMP_INLINE void above_all(const Rules &rules, const Layer &layer, int n, const Light &term,
                             ConstRow alpha, const float *lo, const float *hi, const State &at) {
    Plane f_a, f_b;
    Row alpha_sum = at.alpha;
    factor(layer.factor_a, at.alpha, n, f_a);
    factor(layer.factor_b, alpha, n, f_b);
    if (rules.bounded) bound(n, f_a, f_b, lo, hi, at);
    for (int i = 0; i < n; ++i) alpha_sum[i] = at_most_one(f_a[i] * alpha[i] + f_b[i] * alpha_sum[i]);
    add(rules, n, at.light, f_b, term, f_a, layer.behind);  // Eq. 2 with (+)
}

HPCOMP_INLINE Light light_at(const Light &light, int64_t pixel) {
    return {light.luminance + pixel, light.p0 + pixel, light.p1 + pixel,
            light.red + pixel, light.green + pixel, light.blue + pixel,
            light.strength ? light.strength + pixel : nullptr};
}

HPCOMP_INLINE State state_at(const State &state, int64_t pixel) {
    return {light_at(state.light, pixel), state.alpha + pixel,
            state.transmittance ? state.transmittance + pixel : nullptr,
            state.lo ? state.lo + pixel : nullptr, state.hi ? state.hi + pixel : nullptr,
            state.phase ? state.phase + pixel : nullptr, state.left, state.top};
}

HPCOMP_INLINE void show(const Observer &observer, int number, int x, int y, int n, const Light &term,
                        const float *alpha) {
    observer.term(observer.self, number, x, y, n, term.red, term.green, term.blue, alpha, term.luminance, term.p0,
                  term.p1);
}

// Whether a layer changes anything in `n` pixels from column `x` of row `y` on: it has pixels there, or it erases
// what lies around them. The bottom layer is where all others begin.
HPCOMP_INLINE bool takes_part(const Layer &layer, int number, int x, int y, int n) {
    const bool in_row = y >= layer.top && y - layer.top < layer.height;
    const bool in_columns = layer.left - x < n && x - layer.left < layer.width;
    const bool erases = layer.factor_b == Factor::kZero || layer.factor_b == Factor::kAlpha;
    return (in_row && in_columns) || erases || number == 0;
}

void add_layers(const Rules &rules, const Layer *layers, const int *numbers, int count, int width,
                int height, const State &state, int64_t *nonfinite, const Observer *observer) {
    for (int y = 0; y < height; ++y) {
        for (int x = 0; x < width; x += kBlock) {
            const int n = width - x < kBlock ? width - x : kBlock;
            const State at = state_at(state, int64_t(y) * width + x);
            for (int k = 0; k < count; ++k) {
                if (!takes_part(layers[k], numbers[k], x, y, n)) continue;
                LightPlanes planes;
                Plane alpha, lo, hi;
                const Light term = planes.light(rules.strength);
                nonfinite[k] += load_term(rules, layers[k], x, y, n, term, alpha, lo, hi);
                if (observer) show(*observer, numbers[k], x, y, n, term, alpha);
                if (rules.order == Order::kFrontToBack) {
                    under_all(rules, n, term, alpha, lo, hi, at);
                } else if (numbers[k] == 0) {
                    copy(n, term, at.light);
                    std::memcpy(at.alpha, alpha, n * sizeof(float));
                    if (rules.bounded) {
                        std::memcpy(at.lo, lo, n * sizeof(float));
                        std::memcpy(at.hi, hi, n * sizeof(float));
                    }
                } else {
                    above_all(rules, layers[k], n, term, alpha, lo, hi, at);
                }
            }
            if (observer) observer->block(observer->self, x, y, n);
        }
    }
}

// --- reductions of all layers --------------------------------------------------------------------

// The sum of weighted terms, of which `kept` is kept: planes (count, kBlock).
HPCOMP_INLINE void sum_terms(int count, int n, const float *weight, const float *kept, const Light &terms,
                             const Light &to) {
    for (int begin = 0; begin < n; begin += kLanes) {
        float luminance[kLanes] = {}, red[kLanes] = {}, green[kLanes] = {}, blue[kLanes] = {}, grey[kLanes] = {};
        for (int k = 0; k < count; ++k) {
            const int64_t at = int64_t(k) * kBlock + begin;
            ConstRow w = weight + at, share = kept + at, y = terms.luminance + at;
            ConstRow r = terms.red + at, g = terms.green + at, b = terms.blue + at;
            for (int l = 0; l < kLanes; ++l) {
                const float light = w[l] * y[l], factor = w[l] * share[l];
                const float lost = light - factor * y[l];
                luminance[l] += light;  // [R1]
                grey[l] += share[l] == 1 ? 0.0f : lost;  // of what is infinite, too
                red[l] += factor * r[l];
                green[l] += factor * g[l];
                blue[l] += factor * b[l];
            }
        }
        const int lanes = n - begin < kLanes ? n - begin : kLanes;
        for (int l = 0; l < lanes; ++l) {
            to.luminance[begin + l] = luminance[l];
            to.red[begin + l] = red[l] + grey[l];
            to.green[begin + l] = green[l] + grey[l];
            to.blue[begin + l] = blue[l] + grey[l];
        }
    }
}

// What lies below the stack, as one more term of the weight that the alpha of the others leaves it.
void add_background_term(const Rules &rules, int n, const Light &term, float *weight, const State &at) {
    for (int i = 0; i < n; ++i) {
        weight[i] = 1 - at.alpha[i];
        term.luminance[i] = rules.background_luminance;
        term.p0[i] = weight[i] * rules.background_p[0];
        term.p1[i] = weight[i] * rules.background_p[1];
        term.red[i] = rules.background_rgb[0];
        term.green[i] = rules.background_rgb[1];
        term.blue[i] = rules.background_rgb[2];
        at.lo[i] += weight[i] * rules.background_bounds[0];
        at.hi[i] += weight[i] * rules.background_bounds[1];
        at.alpha[i] = 1;
    }
    for (int i = 0; term.strength && i < n; ++i) term.strength[i] = weight[i] * rules.background_strength;
}

// `scratch` holds `scratch_floats` of them.
void reduce_layers(const Rules &rules, const Layer *layers, const int *numbers, int count, int width, int height,
                   const State &state, float *scratch, int64_t *nonfinite, const Observer *observer) {
    const bool with_background = rules.order == Order::kWoven && rules.has_background;
    const bool strong = rules.strength != Strength::kChroma;
    const int64_t most = count + (rules.order == Order::kWoven ? 1 : 0);
    float *reducing = scratch + term_floats(most);
    int *there = reinterpret_cast<int *>(reducing + reducing_floats(rules.order, most, rules.layers));
    for (int y = 0; y < height; ++y) {
        for (int x = 0; x < width; x += kBlock) {
            const int n = width - x < kBlock ? width - x : kBlock;
            const State at = state_at(state, int64_t(y) * width + x);
            int terms_there = 0;
            for (int k = 0; k < count; ++k)
                if (takes_part(layers[k], numbers[k], x, y, n)) there[terms_there++] = k;
            const int all = terms_there + (with_background ? 1 : 0);
            const int64_t planes = int64_t(all) * kBlock;
            float *p = scratch;  // (all, 2, kBlock), then the others (all, kBlock):
            const Light terms{p + 2 * planes, nullptr,       nullptr, p + 3 * planes, p + 4 * planes,
                              p + 5 * planes, strong ? p + 9 * planes : nullptr};
            float *f_a = p + 6 * planes, *f_b = p + 7 * planes, *kept = p + 8 * planes;
            const auto term_at = [&](int k) {
                const int64_t of = int64_t(k) * kBlock;
                return Light{terms.luminance + of, p + 2 * of,        p + 2 * of + kBlock, terms.red + of,
                             terms.green + of,     terms.blue + of, strong ? terms.strength + of : nullptr};
            };
            // Lanes beyond the row take part in the reduction, and must be harmless.
            if (n < kBlock) std::memset(scratch, 0, size_t(kTermPlanes * planes) * sizeof(float));
            for (int k = 0; k < terms_there; ++k) {
                const int number = numbers[there[k]];
                const Layer &layer = layers[there[k]];
                Plane alpha, lo, hi;
                const Light term = term_at(k);
                float *layer_a = f_a + int64_t(k) * kBlock, *layer_b = f_b + int64_t(k) * kBlock;
                nonfinite[there[k]] += load_term(rules, layer, x, y, n, term, alpha, lo, hi);
                there[k] = number;
                if (observer) show(*observer, number, x, y, n, term, alpha);
                factors(layer, number, n, alpha, layer_a, layer_b, at.alpha);
                if (!rules.bounded) continue;
                if (number == 0) {
                    // Under it was nothing, of which the planes know not.
                    std::memset(at.lo, 0, n * sizeof(float));
                    std::memset(at.hi, 0, n * sizeof(float));
                }
                bound(n, layer_a, layer_b, lo, hi, at);
            }
            weigh(terms_there, n, f_a, f_b, p, terms.strength);
            if (with_background)
                add_background_term(rules, n, term_at(terms_there), f_a + int64_t(terms_there) * kBlock, at);
            if (rules.order == Order::kWoven) {
                Plane phase;
                if (at.phase) {
                    std::memset(phase, 0, sizeof phase);
                    std::memcpy(phase, at.phase, n * sizeof(float));
                } else {
                    phases(rules.weave, state.left + x, state.top + y, phase);
                }
                weave_terms(rules, p, terms.strength, all, n, phase, reducing, kept);
            } else {
                reduce_terms(rules, there, p, terms.strength, all, n, kept, f_b, reducing);
            }
            std::memcpy(at.light.p0, p, n * sizeof(float));
            std::memcpy(at.light.p1, p + kBlock, n * sizeof(float));
            if (strong) std::memcpy(at.light.strength, terms.strength, n * sizeof(float));
            if (rules.maps != Maps::kLinear)  // the plain sum
                for (int64_t i = 0; i < planes; ++i) kept[i] = 1;
            sum_terms(all, n, f_a, kept, terms, at.light);
            if (observer) observer->block(observer->self, x, y, n);
        }
    }
}

// --- planes to samples ---------------------------------------------------------------------------

// The same luminance and hue with every channel in [0, 1]: chroma shrinks, white and black are ends.
void straight_into_gamut(const double *weights, float *rgb) {
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

// Some of the colours of a block, by the way back of the space of the codes.
void into_gamut(const Output &out, const int *indices, int count, float *red, float *green, float *blue) {
    const bool straight = out.space.maps == Maps::kLinear || out.space.maps == Maps::kHsl;
    LightPlanes planes;
    Plane lo, hi;
    int known = 0;
    int of_known[kBlock];
    for (int k = 0; k < count; ++k) {
        const int i = indices[k];
        const double luminance = out.weights[0] * red[i] + out.weights[1] * green[i] + out.weights[2] * blue[i];
        if (straight || !(luminance > 0 && luminance < 1)) {
            float rgb[3] = {red[i], green[i], blue[i]};
            straight_into_gamut(out.weights, rgb);
            red[i] = rgb[0], green[i] = rgb[1], blue[i] = rgb[2];
            continue;
        }
        planes.red[known] = red[i], planes.green[known] = green[i], planes.blue[known] = blue[i];
        planes.luminance[known] = float(luminance);
        of_known[known++] = i;
    }
    if (known == 0) return;
    to_p(out.space, known, planes.red, planes.green, planes.blue, planes.luminance, planes.p0, planes.p1);
    for (int k = 0; k < known; ++k) lo[k] = 0, hi[k] = 1;
    bring_within(out.space, known, planes.luminance, planes.p0, planes.p1, lo, hi, planes.red, planes.green,
                 planes.blue);
    for (int k = 0; k < known; ++k) {
        const int i = of_known[k];
        red[i] = planes.red[k], green[i] = planes.green[k], blue[i] = planes.blue[k];
    }
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
        int indices[kBlock], count = 0;
        for (int i = 0; i < n; ++i) {
            const float least = smallest_of(red[i], green[i], blue[i]);
            const float most = largest_of(red[i], green[i], blue[i]);
            if (least < out.lowest || most > out.highest) indices[count++] = i;
        }
        into_gamut(out, indices, count, red, green, blue);
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

// A colour beyond what a half holds becomes darker: all channels are scaled alike, so that its hue stays.
// What is infinite stays so.
HPCOMP_INLINE void into_half_range(float *red, float *green, float *blue) {
    float *const channels[3] = {red, green, blue};
    float size = kLargestHalf;
    for (const float *v : channels) size = beyond_half(*v) ? larger(magnitude(*v), size) : size;
    const float factor = kLargestHalf / size;
    for (float *v : channels) *v *= factor;
}

// The stack over its background: its light, its alpha and what bounds it. Woven terms have it among them.
HPCOMP_INLINE void put_on_background(const Rules &rules, int n, const Light &stack, Row alpha, Row lo, Row hi) {
    if (!rules.has_background || rules.order == Order::kWoven) return;
    LightPlanes planes;
    Plane whole, uncovered;
    for (int i = 0; i < n; ++i) whole[i] = 1, uncovered[i] = 1 - alpha[i];
    if (rules.bounded) {
        for (int i = 0; i < n; ++i) {
            lo[i] += uncovered[i] * rules.background_bounds[0];
            hi[i] += uncovered[i] * rules.background_bounds[1];
        }
    }
    for (int i = 0; i < n; ++i) {
        planes.luminance[i] = rules.background_luminance;
        planes.p0[i] = rules.background_p[0];
        planes.p1[i] = rules.background_p[1];
        planes.red[i] = rules.background_rgb[0];
        planes.green[i] = rules.background_rgb[1];
        planes.blue[i] = rules.background_rgb[2];
        planes.strength[i] = rules.background_strength;
        alpha[i] = 1;
    }
    add(rules, n, stack, whole, planes.light(rules.strength), uncovered, true);
}

void finish(const Rules &rules, int64_t pixels, const State &state, const Output &out, Losses *losses) {
    for (int64_t begin = 0; begin < pixels; begin += kBlock) {
        const int n = pixels - begin < kBlock ? int(pixels - begin) : kBlock;
        const State at = state_at(state, begin);
        LightPlanes planes;
        const Light light = planes.light(rules.strength);
        Plane alpha, lo, hi;
        copy(n, at.light, light);
        std::memcpy(alpha, at.alpha, n * sizeof(float));
        if (rules.bounded) {
            std::memcpy(lo, at.lo, n * sizeof(float));
            std::memcpy(hi, at.hi, n * sizeof(float));
        }
        put_on_background(rules, n, light, alpha, lo, hi);
        if (rules.maps != Maps::kLinear)
            to_color(rules, n, light, lo, hi);
        else if (rules.bounded)
            bring_within(rules, n, light.luminance, light.p0, light.p1, lo, hi, light.red, light.green,
                         light.blue);
        float *const red = planes.red, *const green = planes.green, *const blue = planes.blue;
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
            }
            if (beyond)
                for (int i = 0; i < n; ++i) into_half_range(&red[i], &green[i], &blue[i]);
            for (int i = 0; i < n; ++i) {
                to[4 * i] = to_half(red[i]);
                to[4 * i + 1] = to_half(green[i]);
                to[4 * i + 2] = to_half(blue[i]);
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
