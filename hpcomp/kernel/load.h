// Stored samples to planes: linear and premultiplied, then as terms of a stack.

#pragma once

#include "spaces.h"

namespace hpcomp {
namespace {

constexpr int kCacheLine = 64;
// Pixels that are unpacked between two looks ahead: memory is asked for while it is computed on.
constexpr int kAhead = 64;

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

// Colours of `n` pixels in other primaries. White becomes white, so equal channels stay equal.
HPCOMP_INLINE void convert(const float (&m)[3][2], int n, float *red, float *green, float *blue) {
    for (int i = 0; i < n; ++i) {
        const float g = green[i], red_green = red[i] - g, blue_green = blue[i] - g;
        red[i] = sum_of(g, m[0], red_green, blue_green);
        green[i] = sum_of(g, m[1], red_green, blue_green);
        blue[i] = sum_of(g, m[2], red_green, blue_green);
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
    if (layer.has_matrix && layer.channels >= 3) convert(layer.matrix, there, red, green, blue);
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

// Luminance and p of colours, in a space whose maps are linear.
HPCOMP_INLINE void to_plane(const Rules &rules, int n, const float *red, const float *green, const float *blue,
                            float *luminance, float *p0, float *p1) {
    for (int i = 0; i < n; ++i) {
        const float red_green = red[i] - green[i], blue_green = blue[i] - green[i];
        luminance[i] = green[i] + rules.weight_red * red_green + rules.weight_blue * blue_green;
        p0[i] = red_green * rules.to_p[0][0] + blue_green * rules.to_p[0][1];
        p1[i] = red_green * rules.to_p[1][0] + blue_green * rules.to_p[1][1];
    }
}

HPCOMP_INLINE bool any_hue(int n, const float *p0, const float *p1) {
    int any = 0;
    for (int i = 0; i < n; ++i) any |= (p0[i] != 0) | (p1[i] != 0);
    return any != 0;
}

// Strengths from Oklab's chroma of premultiplied colours, which is of degree 1/3, and their alpha. What has
// no hue has no strength.
HPCOMP_INLINE void to_strengths(const Rules &rules, int n, const float *alpha, const float *p0, const float *p1,
                                float *strength) {
    const bool covers = rules.strength == Strength::kCoverage;
#pragma GCC ivdep
    for (int i = 0; i < n; ++i) {
        const float chroma = strength[i], root = cube_root(alpha[i]);
        const float whole = chroma + root * rules.half_chroma;
        const float coverage = whole != 0 ? alpha[i] * (chroma / whole) : 0.0f;
        const float m = covers ? coverage : root * root * chroma;
        strength[i] = (p0[i] != 0) | (p1[i] != 0) ? m : 0.0f;
    }
}

// Colours as terms of the stack: luminance and p, and where they have one their strength.
HPCOMP_INLINE void to_terms(const Rules &rules, int n, const Light &to, const float *alpha) {
    const float *red = to.red, *green = to.green, *blue = to.blue;
    float *luminance = to.luminance, *p0 = to.p0, *p1 = to.p1;
    if (rules.maps != Maps::kLinear) {
        for (int i = 0; i < n; ++i)
            luminance[i] = green[i] + rules.weight_red * (red[i] - green[i]) +
                           rules.weight_blue * (blue[i] - green[i]);
    }
    if (to.strength && rules.maps == Maps::kOklab) {
        to_oklab<true>(rules, n, red, green, blue, luminance, p0, p1, to.strength);
        to_strengths(rules, n, alpha, p0, p1, to.strength);
        return;
    }
    if (rules.maps != Maps::kLinear) {
        to_p(rules, n, red, green, blue, luminance, p0, p1);
    } else {
        to_plane(rules, n, red, green, blue, luminance, p0, p1);
    }
    if (to.strength == nullptr) return;
    if (!any_hue(n, p0, p1)) {  // greys, and where the layer is not: most of many pictures
        for (int i = 0; i < n; ++i) to.strength[i] = 0;
        return;
    }
    oklab_chroma(rules.perception, n, red, green, blue, to.strength);
    to_strengths(rules, n, alpha, p0, p1, to.strength);
}
// A block of a layer as a term and its alpha, and where results are bounded what bounds its channels.
// Returns as `load` does.
HPCOMP_INLINE int64_t load_term(const Rules &rules, const Layer &layer, int x, int y, int n, const Light &to,
                                float *alpha, float *lo, float *hi) {
    const int64_t nonfinite = load(layer, x, y, n, to.red, to.green, to.blue, alpha);
    to_terms(rules, n, to, alpha);
    if (rules.bounded) {
        for (int i = 0; i < n; ++i) {
            lo[i] = smaller(smallest_of(to.red[i], to.green[i], to.blue[i]), 0.0f);
            hi[i] = larger(alpha[i], largest_of(to.red[i], to.green[i], to.blue[i]));  // not a NaN alpha
        }
    }
    return nonfinite;
}

}  // namespace
}  // namespace hpcomp
