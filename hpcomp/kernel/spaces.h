// Blending spaces whose maps are not linear: colours to luminance and p, and back into gamut.

#pragma once

#include "floats.h"

namespace hpcomp {
namespace {

// The cube root, good to three units in the last place, in multiplications alone: the inverse one
// by a guess at its bits, within 4%, and two steps of third order.
HPCOMP_INLINE float cube_root(float value) {
    const float x = magnitude(value);
    const int32_t third = int32_t(float(int32_t(bits_of(x))) * (1.0f / 3));
    float r = float_of(uint32_t(0x54a21d2a - third));
    for (int step = 0; step < 2; ++step) {
        const float h = 1 - (x * r) * (r * r);
        r += r * (h * (0.333333333f + h * 0.222222222f));
    }
    return (value * r) * r;
}

// base + a * first + b * last.
HPCOMP_INLINE float sum_of(float base, const float (&pair)[2], float first, float last) {
    return base + pair[0] * first + pair[1] * last;
}

// |p| whatever its size, scaled by one power of two.
struct Scaled {
    float x, y, length, up;
};
HPCOMP_INLINE Scaled scaled(float p0, float p1) {
    const Scale scale = scale_of(p0, p1, 0, 0);
    const float x = p0 * scale.down, y = p1 * scale.down;
    return {x, y, __builtin_sqrtf(x * x + y * y), scale.up};
}

HPCOMP_INLINE float largest_of(float a, float b, float c) { return larger(larger(a, b), c); }
HPCOMP_INLINE float smallest_of(float a, float b, float c) { return smaller(smaller(a, b), c); }

// --- colours to p --------------------------------------------------------------------------------

HPCOMP_INLINE void to_hsl(const Rules &rules, int n, const float *red, const float *green,
                          const float *blue, float *p0, float *p1) {
    for (int i = 0; i < n; ++i) {
        const float red_green = red[i] - green[i], blue_green = blue[i] - green[i];
        const Scaled p = scaled(red_green * rules.to_p[0][0] + blue_green * rules.to_p[0][1],
                                red_green * rules.to_p[1][0] + blue_green * rules.to_p[1][1]);
        const float spread =
            largest_of(red[i], green[i], blue[i]) - smallest_of(red[i], green[i], blue[i]);
        const float size = p.length > 0 ? spread / p.length : 0.0f;
        p0[i] = p.x * size;
        p1[i] = p.y * size;
    }
}

HPCOMP_INLINE void to_oklab(const Rules &rules, int n, const float *red, const float *green,
                            const float *blue, const float *luminance, float *p0, float *p1) {
    const OklabNumbers &numbers = rules.oklab;
    for (int i = 0; i < n; ++i) {
        const float red_green = red[i] - green[i], blue_green = blue[i] - green[i];
        const float middle = cube_root(sum_of(green[i], numbers.to_lms[1], red_green, blue_green));
        const float lng = cube_root(sum_of(green[i], numbers.to_lms[0], red_green, blue_green)) - middle;
        const float shrt = cube_root(sum_of(green[i], numbers.to_lms[2], red_green, blue_green)) - middle;
        const float lightness = sum_of(middle, numbers.to_lab[0], lng, shrt);
        const float a = numbers.to_lab[1][0] * lng + numbers.to_lab[1][1] * shrt;
        const float b = numbers.to_lab[2][0] * lng + numbers.to_lab[2][1] * shrt;
        // As L vanishes, p/Y grows to its bound and stays there: the direction is (a, b) throughout.
        const float whole = larger(lightness, __builtin_sqrtf(a * a + b * b) * numbers.inverse_largest);
        const float share = luminance[i] / whole;
        const bool there = luminance[i] > 0 && whole > 0;
        p0[i] = there ? a * share : 0.0f;
        p1[i] = there ? b * share : 0.0f;
    }
}

constexpr float kLabRoot = 6.0f / 29, kLabCube = kLabRoot * kLabRoot * kLabRoot;
constexpr float kLabSlope = 1 / (3 * kLabRoot * kLabRoot), kLabStart = 4.0f / 29;
// X and Z at Y = 1 are held within it, so that squares of their roots are floats.
constexpr float kFarthestXz = 1e15f;

// f(X) - f(Y) of CIELAB, for X over that of the white of luminance Y; 0 where they are equal.
HPCOMP_INLINE float root_less_one(float share) {
    const float held = larger(smaller(share, kFarthestXz), -kFarthestXz);
    const float root = cube_root(held) - cube_root(1.0f);
    return held > kLabCube ? root : kLabSlope * held + (kLabStart - 1);
}

HPCOMP_INLINE void to_cielab(const Rules &rules, int n, const float *red, const float *green,
                             const float *blue, const float *luminance, float *p0, float *p1) {
    const CielabNumbers &numbers = rules.cielab;
    for (int i = 0; i < n; ++i) {
        const float red_green = red[i] - green[i], blue_green = blue[i] - green[i];
        const float x = sum_of(green[i], numbers.to_xz[0], red_green, blue_green);
        const float z = sum_of(green[i], numbers.to_xz[1], red_green, blue_green);
        const float a = 5 * root_less_one(x / luminance[i]);
        const float b = -2 * root_less_one(z / luminance[i]);
        const float beyond = larger(1.0f, __builtin_sqrtf(a * a + b * b) * numbers.inverse_largest);
        const float share = luminance[i] / beyond;
        p0[i] = luminance[i] > 0 ? a * share : 0.0f;
        p1[i] = luminance[i] > 0 ? b * share : 0.0f;
    }
}

// p of colours of known luminance, in a space whose maps are not linear.
HPCOMP_INLINE void to_p(const Rules &rules, int n, const float *red, const float *green,
                        const float *blue, const float *luminance, float *p0, float *p1) {
    switch (rules.maps) {
    case Maps::kHsl: to_hsl(rules, n, red, green, blue, p0, p1); break;
    case Maps::kOklab: to_oklab(rules, n, red, green, blue, luminance, p0, p1); break;
    case Maps::kCielab: to_cielab(rules, n, red, green, blue, luminance, p0, p1); break;
    case Maps::kLinear: break;
    }
}

// --- p to colours --------------------------------------------------------------------------------

// The colour of a luminance and p, in a space whose maps are linear.
HPCOMP_INLINE void linear_from_p(const Rules &rules, float luminance, float p0, float p1, float *red,
                                 float *green, float *blue) {
    *red = p0 * rules.from_p[0][0] + p1 * rules.from_p[0][1] + luminance;
    *green = p0 * rules.from_p[1][0] + p1 * rules.from_p[1][1] + luminance;
    *blue = p0 * rules.from_p[2][0] + p1 * rules.from_p[2][1] + luminance;
}

HPCOMP_INLINE void from_hsl(const Rules &rules, int n, const float *luminance, const float *p0,
                            const float *p1, float *red, float *green, float *blue) {
    for (int i = 0; i < n; ++i) {
        const Scaled p = scaled(p0[i], p1[i]);
        const float r = p.x * rules.from_p[0][0] + p.y * rules.from_p[0][1];
        const float g = p.x * rules.from_p[1][0] + p.y * rules.from_p[1][1];
        const float b = p.x * rules.from_p[2][0] + p.y * rules.from_p[2][1];
        const float spread = largest_of(r, g, b) - smallest_of(r, g, b);
        const float size = spread > 0 ? p.length / spread : 0.0f;
        red[i] = luminance[i] + r * size * p.up;
        green[i] = luminance[i] + g * size * p.up;
        blue[i] = luminance[i] + b * size * p.up;
    }
}

// p/Y, no longer than its bound, and 0 where Y is not positive.
HPCOMP_INLINE void chromaticity(float luminance, float p0, float p1, float inverse_largest, float *q0,
                                float *q1) {
    const Scaled p = scaled(p0, p1);
    const float whole = larger(luminance, p.length * inverse_largest * p.up);
    *q0 = luminance > 0 ? p0 / whole : 0.0f;
    *q1 = luminance > 0 ? p1 / whole : 0.0f;
}

HPCOMP_INLINE void from_oklab(const Rules &rules, int n, const float *luminance, const float *p0,
                              const float *p1, float *red, float *green, float *blue) {
    const OklabNumbers &numbers = rules.oklab;
    for (int i = 0; i < n; ++i) {
        float q0, q1;
        chromaticity(luminance[i], p0[i], p1[i], numbers.inverse_largest, &q0, &q1);
        const float l = sum_of(1, numbers.to_roots[0], q0, q1), m = sum_of(1, numbers.to_roots[1], q0, q1);
        const float s = sum_of(1, numbers.to_roots[2], q0, q1);
        const float middle = m * m * m, lng = l * l * l - middle, shrt = s * s * s - middle;
        const float r = sum_of(middle, numbers.from_lms[0], lng, shrt);
        const float g = sum_of(middle, numbers.from_lms[1], lng, shrt);
        const float b = sum_of(middle, numbers.from_lms[2], lng, shrt);
        const float size =
            luminance[i] / (g + rules.weight_red * (r - g) + rules.weight_blue * (b - g));
        red[i] = r * size;
        green[i] = g * size;
        blue[i] = b * size;
    }
}

HPCOMP_INLINE float share_less_one(float root) {
    return (root > kLabRoot ? root * root * root : (root - kLabStart) / kLabSlope) - 1;
}

HPCOMP_INLINE void from_cielab(const Rules &rules, int n, const float *luminance, const float *p0,
                               const float *p1, float *red, float *green, float *blue) {
    const CielabNumbers &numbers = rules.cielab;
    for (int i = 0; i < n; ++i) {
        float q0, q1;
        chromaticity(luminance[i], p0[i], p1[i], numbers.inverse_largest, &q0, &q1);
        const float x = share_less_one(1 + q0 * 0.2f), z = share_less_one(1 - q1 * 0.5f);
        red[i] = sum_of(1, numbers.from_xz[0], x, z) * luminance[i];
        green[i] = sum_of(1, numbers.from_xz[1], x, z) * luminance[i];
        blue[i] = sum_of(1, numbers.from_xz[2], x, z) * luminance[i];
    }
}

// Colours beyond [lo, hi] go straight towards the grey of their luminance, as far as needed.
HPCOMP_INLINE void bring_within(int n, const float *luminance, const float *lo, const float *hi, float *red,
                          float *green, float *blue) {
    for (int i = 0; i < n; ++i) {
        const float y = luminance[i], above = larger(hi[i] - y, 0.0f), below = larger(y - lo[i], 0.0f);
        const float most = largest_of(red[i], green[i], blue[i]) - y;
        const float least = y - smallest_of(red[i], green[i], blue[i]);
        const float down = most > above ? above / most : 1.0f;
        const float t = smaller(down, least > below ? below / least : 1.0f);
        red[i] = t < 1 ? y + t * (red[i] - y) : red[i];
        green[i] = t < 1 ? y + t * (green[i] - y) : green[i];
        blue[i] = t < 1 ? y + t * (blue[i] - y) : blue[i];
    }
}

// Colours of luminance and p within [lo, hi], in a space whose maps are not linear.
HPCOMP_INLINE void from_p(const Rules &rules, int n, const float *luminance, const float *p0,
                          const float *p1, const float *lo, const float *hi, float *red, float *green,
                          float *blue) {
    switch (rules.maps) {
    case Maps::kHsl: from_hsl(rules, n, luminance, p0, p1, red, green, blue); break;
    case Maps::kOklab: from_oklab(rules, n, luminance, p0, p1, red, green, blue); break;
    case Maps::kCielab: from_cielab(rules, n, luminance, p0, p1, red, green, blue); break;
    case Maps::kLinear: break;
    }
    bring_within(n, luminance, lo, hi, red, green, blue);
}

}  // namespace
}  // namespace hpcomp
