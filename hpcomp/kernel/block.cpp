#include "block.h"

#include <cstring>

#ifndef HPCOMP_LEVEL
#error "compile with -DHPCOMP_LEVEL=<name of this instruction set's engine>"
#endif

namespace hpcomp {
namespace {

#define HPCOMP_INLINE static inline __attribute__((always_inline))

using Plane = float[kBlock];

constexpr int kCacheLine = 64;
// Pixels that are unpacked between two looks ahead: memory is asked for while it is computed on.
constexpr int kAhead = 64;

HPCOMP_INLINE uint32_t bits_of(float value) {
    uint32_t bits;
    std::memcpy(&bits, &value, sizeof bits);
    return bits;
}

HPCOMP_INLINE float float_of(uint32_t bits) {
    float value;
    std::memcpy(&value, &bits, sizeof value);
    return value;
}

HPCOMP_INLINE float magnitude(float x) { return float_of(bits_of(x) & 0x7fffffffu); }
HPCOMP_INLINE float smaller(float a, float b) { return a < b ? a : b; }
HPCOMP_INLINE float larger(float a, float b) { return a > b ? a : b; }
// NaN stays NaN.
HPCOMP_INLINE float at_most_one(float x) { return x > 1 ? 1.0f : x; }
HPCOMP_INLINE float clamped(float x) { return x < 0 ? 0.0f : at_most_one(x); }

// --- samples to planes ---------------------------------------------------------------------------

HPCOMP_INLINE float from_half(uint16_t half) {
    const uint32_t sign = uint32_t(half & 0x8000u) << 16;
    // The exponent moves by a multiplication, which also makes subnormals right.
    const float scaled = float_of(uint32_t(half & 0x7fffu) << 13) * 0x1p112f;
    const uint32_t special = (half & 0x7c00u) == 0x7c00u ? 0x7f800000u : 0u;
    return float_of(bits_of(scaled) | special | sign);
}

// Whatever NaN came in, the same comes out: its sign and payload are the compiler's choice.
HPCOMP_INLINE float one_nan(float x) { return x != x ? float_of(0x7fc00000u) : x; }

HPCOMP_INLINE uint16_t to_half(float value) {
    const uint32_t bits = bits_of(one_nan(value));
    const uint32_t sign = bits & 0x80000000u;
    const uint32_t size = bits ^ sign;
    // Below the normal halves the addition of a half rounds; above, the carry into the exponent.
    const uint32_t tiny = bits_of(float_of(size) + 0.5f) - 0x3f000000u;
    const uint32_t normal = (size - 0x38000000u + 0xfffu + ((size >> 13) & 1u)) >> 13;
    const uint32_t special = size > 0x7f800000u ? 0x7e00u : 0x7c00u;
    const uint32_t finite = size < 0x38800000u ? tiny : normal;
    return uint16_t((size >= 0x47800000u ? special : finite) | (sign >> 16));
}

struct Codes8 {
    using Stored = uint8_t;
    const float *decode;
    HPCOMP_INLINE float color(const Codes8 &c, uint8_t v) { return c.decode[v]; }
    HPCOMP_INLINE float alpha(const Codes8 &, uint8_t v) { return float(v) / 255.0f; }
};
struct Codes16 {
    using Stored = uint16_t;
    const float *decode;
    HPCOMP_INLINE float color(const Codes16 &c, uint16_t v) { return c.decode[v]; }
    HPCOMP_INLINE float alpha(const Codes16 &, uint16_t v) { return float(v) / 65535.0f; }
};
struct Halves {
    using Stored = uint16_t;
    const float *decode;
    HPCOMP_INLINE float color(const Halves &, uint16_t v) { return from_half(v); }
    HPCOMP_INLINE float alpha(const Halves &, uint16_t v) { return from_half(v); }
};
struct Floats {
    using Stored = float;
    const float *decode;
    HPCOMP_INLINE float color(const Floats &, float v) { return v; }
    HPCOMP_INLINE float alpha(const Floats &, float v) { return v; }
};

template <class Kind, int Channels>
HPCOMP_INLINE void unpack(const Kind kind, const typename Kind::Stored *stored, int n, float *red,
                          float *green, float *blue, float *alpha) {
    constexpr bool is_grey = Channels <= 2;
    constexpr int kPixelBytes = Channels * int(sizeof(typename Kind::Stored));
    for (int begin = 0; begin < n; begin += kAhead) {
        const int stop = n - begin < kAhead ? n : begin + kAhead;
        // The same run of the next block; processors ignore what lies outside the array.
        const uintptr_t next = reinterpret_cast<uintptr_t>(stored) + uintptr_t((begin + kBlock) * kPixelBytes);
        for (int line = 0; line < kAhead * kPixelBytes; line += kCacheLine)
            __builtin_prefetch(reinterpret_cast<const void *>(next + uintptr_t(line)), 0, 2);
        for (int i = begin; i < stop; ++i) {
            const typename Kind::Stored *pixel = stored + i * Channels;
            red[i] = Kind::color(kind, pixel[0]);
            green[i] = is_grey ? red[i] : Kind::color(kind, pixel[is_grey ? 0 : 1]);
            blue[i] = is_grey ? red[i] : Kind::color(kind, pixel[is_grey ? 0 : 2]);
            alpha[i] = Channels % 2 == 0 ? Kind::alpha(kind, pixel[Channels - 1]) : 1.0f;
        }
    }
}

template <class Kind>
HPCOMP_INLINE void unpack_any(const Layer &layer, int64_t pixel, const char *row, int n, float *red,
                              float *green, float *blue, float *alpha) {
    using Stored = typename Kind::Stored;
    const Stored *stored = reinterpret_cast<const Stored *>(row) + pixel * layer.channels;
    const Kind kind{layer.decode};
    switch (layer.channels) {
    case 1: unpack<Kind, 1>(kind, stored, n, red, green, blue, alpha); break;
    case 2: unpack<Kind, 2>(kind, stored, n, red, green, blue, alpha); break;
    case 3: unpack<Kind, 3>(kind, stored, n, red, green, blue, alpha); break;
    default: unpack<Kind, 4>(kind, stored, n, red, green, blue, alpha); break;
    }
}

// Linear, premultiplied RGBA planes of `n` pixels of row `y` from column `x` of the strip, at the
// layer's opacity: transparent where it has no pixels. Returns how many are NaN or infinite.
HPCOMP_INLINE int64_t load(const Layer &layer, int x, int y, int n, float *red, float *green,
                           float *blue, float *alpha) {
    const int row = y - layer.top;
    int first = layer.left - x, stop = layer.left + layer.width - x;
    first = first < 0 ? 0 : first;
    stop = stop > n ? n : stop;
    if (row < 0 || row >= layer.height || first >= stop) first = stop = n;
    for (int i = 0; i < first; ++i) red[i] = green[i] = blue[i] = alpha[i] = 0;
    for (int i = stop; i < n; ++i) red[i] = green[i] = blue[i] = alpha[i] = 0;
    const int there = stop - first;
    if (there == 0) return 0;
    red += first, green += first, blue += first, alpha += first;

    const char *samples = static_cast<const char *>(layer.samples) + row * layer.row_bytes;
    const int64_t pixel = x + first - layer.left;
    switch (layer.type) {
    case Sample::kU8: unpack_any<Codes8>(layer, pixel, samples, there, red, green, blue, alpha); break;
    case Sample::kU16: unpack_any<Codes16>(layer, pixel, samples, there, red, green, blue, alpha); break;
    case Sample::kHalf: unpack_any<Halves>(layer, pixel, samples, there, red, green, blue, alpha); break;
    case Sample::kFloat: unpack_any<Floats>(layer, pixel, samples, there, red, green, blue, alpha); break;
    }
    int nonfinite = 0;
    if (layer.type == Sample::kHalf || layer.type == Sample::kFloat) {
        for (int i = 0; i < there; ++i) {
            const float nothing = red[i] * 0 + green[i] * 0 + blue[i] * 0 + alpha[i] * 0;
            nonfinite += nothing != nothing;
        }
        if (nonfinite && layer.zero_nonfinite) {
            for (int i = 0; i < there; ++i) {
                const float nothing = red[i] * 0 + green[i] * 0 + blue[i] * 0 + alpha[i] * 0;
                if (nothing != nothing) red[i] = green[i] = blue[i] = alpha[i] = 0;
            }
        }
    }
    if (layer.has_matrix && layer.channels >= 3) {
        const float *m = layer.matrix;
        for (int i = 0; i < there; ++i) {
            const float r = red[i], g = green[i], b = blue[i];
            red[i] = m[0] * r + m[1] * g + m[2] * b;
            green[i] = m[3] * r + m[4] * g + m[5] * b;
            blue[i] = m[6] * r + m[7] * g + m[8] * b;
        }
    }
    if (layer.channels % 2 == 0) {
        for (int i = 0; i < there; ++i) alpha[i] = clamped(alpha[i]);
        if (layer.alpha_straight) {
            for (int i = 0; i < there; ++i) {
                red[i] *= alpha[i];
                green[i] *= alpha[i];
                blue[i] *= alpha[i];
            }
        }
    }
    if (layer.opacity != 1) {
        for (int i = 0; i < there; ++i) {
            red[i] *= layer.opacity;
            green[i] *= layer.opacity;
            blue[i] *= layer.opacity;
            alpha[i] *= layer.opacity;
        }
    }
    return nonfinite;
}

// The same as a term of the stack: luminance, p and alpha.
HPCOMP_INLINE int64_t load_term(const Rules &rules, const Layer &layer, int x, int y, int n,
                                float *luminance, float *p0, float *p1, float *alpha) {
    Plane red, green, blue;
    const int64_t nonfinite = load(layer, x, y, n, red, green, blue, alpha);
    for (int i = 0; i < n; ++i) {
        const float red_green = red[i] - green[i], blue_green = blue[i] - green[i];
        luminance[i] = green[i] + rules.weight_red * red_green + rules.weight_blue * blue_green;
        p0[i] = red_green * rules.to_p[0][0] + blue_green * rules.to_p[0][1];
        p1[i] = red_green * rules.to_p[1][0] + blue_green * rules.to_p[1][1];
    }
    return nonfinite;
}

// --- addition ------------------------------------------------------------------------------------

// The angle in [0, pi] of a vector whose y is not negative; 0 for the zero vector. A polynomial fit
// of atan(r)/r in r*r on [0, 1], good to 3e-8.
HPCOMP_INLINE float angle_of(float y, float x) {
    const float across = magnitude(x);
    const float longer = larger(across, y), shorter = smaller(across, y);
    const float r = longer > 0 ? shorter / longer : 0.0f;
    const float q = r * r;
    float slope = 0.0028340643f;
    slope = slope * q - 0.0160050305f;
    slope = slope * q + 0.0425876075f;
    slope = slope * q - 0.0749544544f;
    slope = slope * q + 0.106367541f;
    slope = slope * q - 0.142025705f;
    slope = slope * q + 0.199924836f;
    slope = slope * q - 0.333330668f;
    slope = slope * q + 0.999999984f;
    float angle = slope * r;
    angle = y > across ? 1.57079633f - angle : angle;
    return x < 0 ? 3.14159265f - angle : angle;
}

// 1 where two hues are equal, 0 where they differ, a smoothstep between.
HPCOMP_INLINE float shoulder(const Rules &rules, float x1, float y1, float x2, float y2) {
    const float angle = angle_of(magnitude(x1 * y2 - y1 * x2), x1 * x2 + y1 * y2);
    const float t = clamped(angle * rules.inverse_tolerance - 1);
    const float smooth = 1 - t * t * (3 - 2 * t);
    const float hard = angle <= rules.tolerance ? 1.0f : 0.0f;
    return rules.inverse_tolerance > 0 ? smooth : hard;
}

// The power of two that brings the largest of four numbers near 1, and its inverse: squares of tiny
// and huge colours stay in the range of the type, and scaling by it rounds nothing.
struct Scale {
    float down, up;
};
HPCOMP_INLINE Scale scale_of(float a, float b, float c, float d) {
    const float largest = larger(larger(magnitude(a), magnitude(b)), larger(magnitude(c), magnitude(d)));
    uint32_t exponent = bits_of(largest) & 0x7f800000u;
    exponent = exponent < 0x00800000u ? 0x00800000u : exponent;
    exponent = exponent > 0x7e800000u ? 0x7e800000u : exponent;
    return {float_of(0x7f000000u - exponent), float_of(exponent)};
}

// p <- p (+) q, or p + q: planes of n.
HPCOMP_INLINE void add(const Rules &rules, int n, float *p0, float *p1, const float *q0,
                       const float *q1) {
    if (!rules.hue_preserving) {
        for (int i = 0; i < n; ++i) {
            p0[i] += q0[i];
            p1[i] += q1[i];
        }
        return;
    }
    for (int i = 0; i < n; ++i) {
        const Scale scale = scale_of(p0[i], p1[i], q0[i], q1[i]);
        const float x1 = p0[i] * scale.down, y1 = p1[i] * scale.down;
        const float x2 = q0[i] * scale.down, y2 = q1[i] * scale.down;
        const float m1 = __builtin_sqrtf(x1 * x1 + y1 * y1), m2 = __builtin_sqrtf(x2 * x2 + y2 * y2);
        const float most = larger(m1, m2), least = smaller(m1, m2);
        const float kept = most > 0 ? (most - least) / most : 0.0f;  // [R3]
        const float x_differ = kept * (m1 >= m2 ? x1 : x2);          // [R2]
        const float y_differ = kept * (m1 >= m2 ? y1 : y2);
        const float e = shoulder(rules, x1, y1, x2, y2);             // [D3]
        p0[i] = (x_differ + e * (x1 + x2 - x_differ)) * scale.up;
        p1[i] = (y_differ + e * (y1 + y2 - y_differ)) * scale.up;
    }
}

HPCOMP_INLINE void factor(Factor kind, const float *alpha, int n, float *out) {
    switch (kind) {
    case Factor::kZero: for (int i = 0; i < n; ++i) out[i] = 0; break;
    case Factor::kOne: for (int i = 0; i < n; ++i) out[i] = 1; break;
    case Factor::kAlpha: for (int i = 0; i < n; ++i) out[i] = alpha[i]; break;
    case Factor::kRest: for (int i = 0; i < n; ++i) out[i] = 1 - alpha[i]; break;
    }
}

// --- folds ---------------------------------------------------------------------------------------

HPCOMP_INLINE void under_all(const Rules &rules, int n, float *luminance, float *p0, float *p1,
                             float *alpha, const State &at) {
    float *transmittance = at.transmittance;
    Plane q0, q1;
    for (int i = 0; i < n; ++i) {
        const float weight = transmittance[i];
        at.luminance[i] += weight * luminance[i];  // [R1]
        q0[i] = weight * p0[i];
        q1[i] = weight * p1[i];
        at.alpha[i] = at_most_one(at.alpha[i] + weight * alpha[i]);
        transmittance[i] *= 1 - alpha[i];
    }
    add(rules, n, at.p0, at.p1, q0, q1);
}

HPCOMP_INLINE void above_all(const Rules &rules, const Layer &layer, int n, float *luminance,
                             float *p0, float *p1, float *alpha, const State &at) {
    Plane f_a, f_b;
    factor(layer.factor_a, at.alpha, n, f_a);
    factor(layer.factor_b, alpha, n, f_b);
    for (int i = 0; i < n; ++i) {
        at.luminance[i] = f_a[i] * luminance[i] + f_b[i] * at.luminance[i];  // [R1]
        at.alpha[i] = at_most_one(f_a[i] * alpha[i] + f_b[i] * at.alpha[i]);
        at.p0[i] *= f_b[i];
        at.p1[i] *= f_b[i];
        p0[i] *= f_a[i];
        p1[i] *= f_a[i];
    }
    add(rules, n, at.p0, at.p1, p0, p1);  // Eq. 2 with (+)
}

HPCOMP_INLINE State state_at(const State &state, int64_t pixel) {
    return {state.luminance + pixel, state.p0 + pixel, state.p1 + pixel, state.alpha + pixel,
            state.transmittance ? state.transmittance + pixel : nullptr};
}

void add_layers(const Rules &rules, const Layer *layers, const int *numbers, int count, int width,
                int height, const State &state, int64_t *nonfinite) {
    for (int y = 0; y < height; ++y) {
        for (int x = 0; x < width; x += kBlock) {
            const int n = width - x < kBlock ? width - x : kBlock;
            const State at = state_at(state, int64_t(y) * width + x);
            for (int k = 0; k < count; ++k) {
                Plane luminance, p0, p1, alpha;
                nonfinite[k] += load_term(rules, layers[k], x, y, n, luminance, p0, p1, alpha);
                if (rules.order == Order::kFrontToBack) {
                    under_all(rules, n, luminance, p0, p1, alpha, at);
                } else if (numbers[k] == 0) {
                    std::memcpy(at.luminance, luminance, n * sizeof(float));
                    std::memcpy(at.p0, p0, n * sizeof(float));
                    std::memcpy(at.p1, p1, n * sizeof(float));
                    std::memcpy(at.alpha, alpha, n * sizeof(float));
                } else {
                    above_all(rules, layers[k], n, luminance, p0, p1, alpha, at);
                }
            }
        }
    }
}

// --- reductions of all layers --------------------------------------------------------------------

// Above what rounding changes in the products of two vectors of lengths up to 3.
constexpr float kCloseMargin = 1e-4f;

// Rows of lanes: small loops whose arrays do not overlap.
using Row = float *__restrict__;
using ConstRow = const float *__restrict__;

// Whether two hues are close in any lane: within the shoulder's end, or nearly.
HPCOMP_INLINE bool any_close(const Rules &rules, ConstRow xi, ConstRow yi, ConstRow xj, ConstRow yj) {
    int close = 0;
    for (int l = 0; l < kLanes; ++l) {
        const float cosine = xi[l] * xj[l] + yi[l] * yj[l];
        const float sine = magnitude(xi[l] * yj[l] - yi[l] * xj[l]);
        close |= sine * rules.end_cosine <= cosine * rules.end_sine + kCloseMargin;
    }
    return close != 0;
}

HPCOMP_INLINE void shoulders(const Rules &rules, ConstRow xi, ConstRow yi, ConstRow xj, ConstRow yj,
                             Row ij, Row ji) {
    for (int l = 0; l < kLanes; ++l) {
        const float e = shoulder(rules, xi[l], yi[l], xj[l], yj[l]);
        ij[l] = e;
        ji[l] = e;
    }
}

HPCOMP_INLINE void add_least(ConstRow m_j, ConstRow m_k, Row sum) {
    for (int l = 0; l < kLanes; ++l) sum[l] += smaller(m_j[l], m_k[l]);
}

// Some lanes as one value, which stays in a register from one term to the next where a row would go
// through memory; as many as a register of this instruction set holds.
#if defined(__AVX512F__)
constexpr int kRegister = 16;
#elif defined(__AVX__)
constexpr int kRegister = 8;
#else
constexpr int kRegister = 4;
#endif
typedef float Lanes __attribute__((vector_size(kRegister * sizeof(float))));

HPCOMP_INLINE Lanes lanes_of(const float *row) {
    Lanes lanes;
    std::memcpy(&lanes, row, sizeof lanes);
    return lanes;
}

HPCOMP_INLINE Lanes smaller(Lanes a, Lanes b) { return a < b ? a : b; }

// The simultaneous rule for one run of lanes: terms p (count, 2, kBlock) from column `begin`.
HPCOMP_INLINE void rivals_scaled_sum(const Rules &rules, const float *p, int count, int begin,
                                     float *pairs, int *there, float *sum0, float *sum1) {
    int n = 0;
    for (int k = 0; k < count; ++k) {
        ConstRow x = p + int64_t(k) * 2 * kBlock + begin, y = x + kBlock;
        int any = 0;
        for (int l = 0; l < kLanes; ++l) any |= (x[l] != 0) | (y[l] != 0);
        there[n] = k;
        n += any;
    }
    for (int l = 0; l < kLanes; ++l) sum0[l] = sum1[l] = 0;
    if (n == 0) return;

    const auto pair = [n](float *table, int i, int k) { return table + (int64_t(i) * n + k) * kLanes; };
    const auto term = [p, there, begin](int k) { return p + int64_t(there[k]) * 2 * kBlock + begin; };
    float *e = pairs, *support = e + int64_t(n) * n * kLanes;
    float *m = support + int64_t(n) * n * kLanes, *hold = m + n * kLanes;
    float *unit_x = hold + n * kLanes, *unit_y = unit_x + n * kLanes;

    // Scaled by one power of two a pixel, as in `add`.
    float largest[kLanes] = {};
    for (int k = 0; k < n; ++k) {
        ConstRow x = term(k), y = x + kBlock;
        for (int l = 0; l < kLanes; ++l)
            largest[l] = larger(largest[l], larger(magnitude(x[l]), magnitude(y[l])));
    }
    for (int k = 0; k < n; ++k) {
        ConstRow x = term(k), y = x + kBlock;
        Row ux = unit_x + k * kLanes, uy = unit_y + k * kLanes, mk = m + k * kLanes;
        for (int l = 0; l < kLanes; ++l) {
            const float down = scale_of(largest[l], 0, 0, 0).down;
            const float sx = x[l] * down, sy = y[l] * down;
            const Scale own = scale_of(sx, sy, 0, 0);  // a weak term has a hue all the same
            ux[l] = sx * own.down;
            uy[l] = sy * own.down;
            mk[l] = __builtin_sqrtf(ux[l] * ux[l] + uy[l] * uy[l]) * own.up;
        }
    }
    // Most hues differ, and then their shoulder is 0 without its angle: `neighbors` lists the
    // others of each term, itself first, in which alone its support has anything.
    int *neighbors = there + count, *degree = neighbors + int64_t(n) * n;
    for (int i = 0; i < n; ++i) {
        Row ii = pair(e, i, i), held = hold + i * kLanes;
        for (int l = 0; l < kLanes; ++l) ii[l] = 1;
        for (int l = 0; l < kLanes; ++l) held[l] = 0;
        // The most that i's own hue can hold; it vanishes with m_i.
        for (int k = 0; k < n; ++k) add_least(m + i * kLanes, m + k * kLanes, held);
        neighbors[int64_t(i) * n] = i;
        degree[i] = 1;
        for (int j = 0; j < i; ++j) {
            const float *xi = unit_x + i * kLanes, *yi = unit_y + i * kLanes;
            const float *xj = unit_x + j * kLanes, *yj = unit_y + j * kLanes;
            if (any_close(rules, xi, yi, xj, yj)) {
                shoulders(rules, xi, yi, xj, yj, pair(e, i, j), pair(e, j, i));
                neighbors[int64_t(i) * n + degree[i]++] = j;
                neighbors[int64_t(j) * n + degree[j]++] = i;
            } else {
                std::memset(pair(e, i, j), 0, kLanes * sizeof(float));
                std::memset(pair(e, j, i), 0, kLanes * sizeof(float));
            }
        }
    }
    // support(i, j): what backs i's hue and not j's.
    for (int i = 0; i < n; ++i) {
        for (int j = 0; j < n; ++j) {
            for (int l = 0; l < kLanes; l += kRegister) {
                Lanes sum = {};
                for (int d = 0; d < degree[i]; ++d) {
                    const int k = neighbors[int64_t(i) * n + d];
                    sum += lanes_of(pair(e, i, k) + l) * lanes_of(m + k * kLanes + l) *
                           (1.0f - lanes_of(pair(e, j, k) + l));
                }
                std::memcpy(pair(support, i, j) + l, &sum, sizeof sum);
            }
        }
    }
    for (int l = 0; l < kLanes; l += kRegister) {
        Lanes total0 = {}, total1 = {};
        for (int i = 0; i < n; ++i) {
            // The strongest rival's (1 - e) q as a fraction: compared without dividing.
            Lanes part = {}, whole = part + 1.0f;
            for (int j = 0; j < n; ++j) {
                if (j == i) continue;
                const Lanes own = lanes_of(pair(support, i, j) + l);
                const Lanes other = smaller(lanes_of(pair(support, j, i) + l),
                                            lanes_of(hold + j * kLanes + l));
                const Lanes weight = (1.0f - lanes_of(pair(e, i, j) + l)) * smaller(other, own);
                const auto stronger = weight * whole > part * own;
                part = stronger ? weight : part;
                whole = stronger ? own : whole;
            }
            const Lanes scaled = 1.0f - part / whole;
            total0 += scaled * lanes_of(term(i) + l);
            total1 += scaled * lanes_of(term(i) + kBlock + l);
        }
        std::memcpy(sum0 + l, &total0, sizeof total0);
        std::memcpy(sum1 + l, &total1, sizeof total1);
    }
}

// Reduces p (count, 2, kBlock) to its first term's place.
HPCOMP_INLINE void reduce_terms(const Rules &rules, float *p, int count, int n, float *scratch,
                                int *there) {
    const auto x = [&](int k) { return p + int64_t(k) * 2 * kBlock; };
    const auto y = [&](int k) { return p + int64_t(k) * 2 * kBlock + kBlock; };
    switch (rules.order) {
    case Order::kBalanced:
        // Neighbours pair level by level; an odd one is carried up.
        for (int step = 1; step < count; step *= 2)
            for (int k = 0; k + step < count; k += 2 * step)
                add(rules, n, x(k), y(k), x(k + step), y(k + step));
        break;
    case Order::kSimultaneous:
        for (int begin = 0; begin < n; begin += kLanes) {
            float sum0[kLanes], sum1[kLanes];
            rivals_scaled_sum(rules, p, count, begin, scratch, there, sum0, sum1);
            std::memcpy(x(0) + begin, sum0, sizeof sum0);
            std::memcpy(y(0) + begin, sum1, sizeof sum1);
        }
        break;
    default: {
        Plane sum0, sum1;
        std::memcpy(sum0, x(rules.permutation[0]), sizeof sum0);
        std::memcpy(sum1, y(rules.permutation[0]), sizeof sum1);
        for (int k = 1; k < count; ++k)
            add(rules, n, sum0, sum1, x(rules.permutation[k]), y(rules.permutation[k]));
        std::memcpy(x(0), sum0, sizeof sum0);
        std::memcpy(y(0), sum1, sizeof sum1);
    }
    }
}

// `scratch` holds `scratch_floats` of them.
void reduce_layers(const Rules &rules, const Layer *layers, int count, int width, int height,
                   const State &state, float *scratch, int64_t *nonfinite) {
    float *p = scratch;                                  // (count, 2, kBlock)
    float *luminance = p + int64_t(count) * 2 * kBlock;  // (count, kBlock), then the factors:
    float *f_a = luminance + int64_t(count) * kBlock, *f_b = f_a + int64_t(count) * kBlock;
    float *pairs = scratch + term_floats(count);
    int *there = reinterpret_cast<int *>(pairs + pair_floats(count));
    for (int y = 0; y < height; ++y) {
        for (int x = 0; x < width; x += kBlock) {
            const int n = width - x < kBlock ? width - x : kBlock;
            const State at = state_at(state, int64_t(y) * width + x);
            for (int k = 0; k < count; ++k) {
                Plane alpha;
                float *p0 = p + int64_t(k) * 2 * kBlock;
                // Lanes beyond the row take part in the reduction, and must be harmless.
                std::memset(p0, 0, 2 * sizeof(Plane));
                nonfinite[k] += load_term(rules, layers[k], x, y, n, luminance + k * kBlock, p0,
                                          p0 + kBlock, alpha);
                if (k == 0) {
                    for (int i = 0; i < n; ++i) f_a[i] = 1, f_b[i] = 0, at.alpha[i] = alpha[i];
                    continue;
                }
                float *a = f_a + k * kBlock, *b = f_b + k * kBlock;
                factor(layers[k].factor_a, at.alpha, n, a);
                factor(layers[k].factor_b, alpha, n, b);
                for (int i = 0; i < n; ++i)
                    at.alpha[i] = at_most_one(a[i] * alpha[i] + b[i] * at.alpha[i]);
            }
            // w_i = F_A,i times the F_B of the layers above, gathered from the top.
            Plane above;
            for (int i = 0; i < n; ++i) above[i] = 1;
            for (int k = count - 1; k >= 0; --k) {
                float *a = f_a + k * kBlock, *b = f_b + k * kBlock;
                float *p0 = p + int64_t(k) * 2 * kBlock, *p1 = p0 + kBlock;
                for (int i = 0; i < n; ++i) {
                    const float weight = a[i] * above[i];
                    above[i] *= b[i];
                    luminance[k * kBlock + i] *= weight;
                    p0[i] *= weight;
                    p1[i] *= weight;
                }
            }
            for (int i = 0; i < n; ++i) at.luminance[i] = 0;
            for (int k = 0; k < count; ++k)
                for (int i = 0; i < n; ++i) at.luminance[i] += luminance[k * kBlock + i];  // [R1]
            reduce_terms(rules, p, count, n, pairs, there);
            std::memcpy(at.p0, p, n * sizeof(float));
            std::memcpy(at.p1, p + kBlock, n * sizeof(float));
        }
    }
}

// --- planes to samples ---------------------------------------------------------------------------

// The same luminance and hue with every channel in [0, 1]: chroma shrinks, white and black are ends.
void into_gamut(const Rules &rules, float *rgb) {
    const double weights[3] = {rules.weight_red, 1.0 - rules.weight_red - rules.weight_blue,
                               rules.weight_blue};
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
HPCOMP_INLINE void store_codes(const Rules &rules, int n, float *red, float *green, float *blue,
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
            into_gamut(rules, rgb);
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
        Plane luminance, p0, p1, alpha, red, green, blue;
        for (int i = 0; i < n; ++i) {
            luminance[i] = at.luminance[i];
            p0[i] = at.p0[i];
            p1[i] = at.p1[i];
            alpha[i] = at.alpha[i];
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
            add(rules, n, p0, p1, q0, q1);
        }
        for (int i = 0; i < n; ++i) {
            red[i] = p0[i] * rules.from_p[0][0] + p1[i] * rules.from_p[0][1] + luminance[i];
            green[i] = p0[i] * rules.from_p[1][0] + p1[i] * rules.from_p[1][1] + luminance[i];
            blue[i] = p0[i] * rules.from_p[2][0] + p1[i] * rules.from_p[2][1] + luminance[i];
        }
        if (rules.gain != 1) {
            for (int i = 0; i < n; ++i) {
                red[i] *= rules.gain;
                green[i] *= rules.gain;
                blue[i] *= rules.gain;
            }
        }
        switch (out.type) {
        case Sample::kU8:
            store_codes(rules, n, red, green, blue, alpha, out,
                        static_cast<uint8_t *>(out.samples) + 4 * begin, losses);
            break;
        case Sample::kU16:
            store_codes(rules, n, red, green, blue, alpha, out,
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
