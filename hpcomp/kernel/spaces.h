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

HPCOMP_INLINE void to_hsl(const SpaceMaps &space, int n, const float *red, const float *green,
                          const float *blue, float *p0, float *p1) {
    for (int i = 0; i < n; ++i) {
        const float red_green = red[i] - green[i], blue_green = blue[i] - green[i];
        const Scaled p = scaled(red_green * space.to_p[0][0] + blue_green * space.to_p[0][1],
                                red_green * space.to_p[1][0] + blue_green * space.to_p[1][1]);
        const float spread =
            largest_of(red[i], green[i], blue[i]) - smallest_of(red[i], green[i], blue[i]);
        const float size = p.length > 0 ? spread / p.length : 0.0f;
        p0[i] = p.x * size;
        p1[i] = p.y * size;
    }
}

struct Lab {
    float lightness, a, b, chroma;
};
HPCOMP_INLINE Lab oklab_of(const OklabNumbers &numbers, float red, float green, float blue) {
    const float red_green = red - green, blue_green = blue - green;
    const float middle = cube_root(sum_of(green, numbers.to_lms[1], red_green, blue_green));
    const float lng = cube_root(sum_of(green, numbers.to_lms[0], red_green, blue_green)) - middle;
    const float shrt = cube_root(sum_of(green, numbers.to_lms[2], red_green, blue_green)) - middle;
    const float lightness = sum_of(middle, numbers.to_lab[0], lng, shrt);
    const float a = numbers.to_lab[1][0] * lng + numbers.to_lab[1][1] * shrt;
    const float b = numbers.to_lab[2][0] * lng + numbers.to_lab[2][1] * shrt;
    return {lightness, a, b, __builtin_sqrtf(a * a + b * b)};
}

// Oklab's chroma of premultiplied colours: of degree 1/3.
HPCOMP_INLINE void oklab_chroma(const OklabNumbers &numbers, int n, const float *red, const float *green,
                                const float *blue, float *chroma) {
#pragma GCC ivdep
    for (int i = 0; i < n; ++i) chroma[i] = oklab_of(numbers, red[i], green[i], blue[i]).chroma;
}

// Also gives Oklab's chroma, where `kChroma` says so.
template <bool kChroma>
HPCOMP_INLINE void to_oklab(const SpaceMaps &space, int n, const float *red, const float *green,
                            const float *blue, const float *luminance, float *p0, float *p1, float *chroma) {
#pragma GCC ivdep
    for (int i = 0; i < n; ++i) {
        const Lab lab = oklab_of(space.oklab, red[i], green[i], blue[i]);
        // As L vanishes, p/Y grows to its bound and stays there: the direction is (a, b) throughout.
        const float whole = larger(lab.lightness, lab.chroma * space.oklab.inverse_largest);
        const float share = luminance[i] / whole;
        const bool there = luminance[i] > 0 && whole > 0;
        p0[i] = there ? lab.a * share : 0.0f;
        p1[i] = there ? lab.b * share : 0.0f;
        if (kChroma) chroma[i] = lab.chroma;
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

HPCOMP_INLINE void to_cielab(const SpaceMaps &space, int n, const float *red, const float *green,
                             const float *blue, const float *luminance, float *p0, float *p1) {
    const CielabNumbers &numbers = space.cielab;
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
HPCOMP_INLINE void to_p(const SpaceMaps &space, int n, const float *red, const float *green,
                        const float *blue, const float *luminance, float *p0, float *p1) {
    switch (space.maps) {
    case Maps::kHsl: to_hsl(space, n, red, green, blue, p0, p1); break;
    case Maps::kOklab: to_oklab<false>(space, n, red, green, blue, luminance, p0, p1, nullptr); break;
    case Maps::kCielab: to_cielab(space, n, red, green, blue, luminance, p0, p1); break;
    case Maps::kLinear: break;
    }
}

// --- p to colours --------------------------------------------------------------------------------

// The colour of a luminance and p, in a space whose maps are linear.
HPCOMP_INLINE void linear_from_p(const SpaceMaps &space, float luminance, float p0, float p1, float *red,
                                 float *green, float *blue) {
    *red = p0 * space.from_p[0][0] + p1 * space.from_p[0][1] + luminance;
    *green = p0 * space.from_p[1][0] + p1 * space.from_p[1][1] + luminance;
    *blue = p0 * space.from_p[2][0] + p1 * space.from_p[2][1] + luminance;
}

HPCOMP_INLINE void from_hsl(const SpaceMaps &space, int n, const float *luminance, const float *p0,
                            const float *p1, float *red, float *green, float *blue) {
    for (int i = 0; i < n; ++i) {
        const Scaled p = scaled(p0[i], p1[i]);
        const float r = p.x * space.from_p[0][0] + p.y * space.from_p[0][1];
        const float g = p.x * space.from_p[1][0] + p.y * space.from_p[1][1];
        const float b = p.x * space.from_p[2][0] + p.y * space.from_p[2][1];
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

HPCOMP_INLINE float luminance_of(const SpaceMaps &space, float r, float g, float b) {
    return g + space.weight_red * (r - g) + space.weight_blue * (b - g);
}

// Spaces in which colours of one hue and luminance lie on a curve in RGB, as the loops take them: `color`
// gives a colour of the chromaticity q = p/Y, of whatever luminance, which it returns.
struct Oklab {
    HPCOMP_INLINE float color(const SpaceMaps &space, float q0, float q1, float *r, float *g, float *b) {
        const OklabNumbers &numbers = space.oklab;
        const float l = sum_of(1, numbers.to_roots[0], q0, q1), m = sum_of(1, numbers.to_roots[1], q0, q1);
        const float s = sum_of(1, numbers.to_roots[2], q0, q1);
        const float middle = m * m * m, lng = l * l * l - middle, shrt = s * s * s - middle;
        *r = sum_of(middle, numbers.from_lms[0], lng, shrt);
        *g = sum_of(middle, numbers.from_lms[1], lng, shrt);
        *b = sum_of(middle, numbers.from_lms[2], lng, shrt);
        return luminance_of(space, *r, *g, *b);
    }
    HPCOMP_INLINE float inverse_largest(const SpaceMaps &space) { return space.oklab.inverse_largest; }
};

struct Cielab {
    HPCOMP_INLINE float share_less_one(float root) {
        return (root > kLabRoot ? root * root * root : (root - kLabStart) / kLabSlope) - 1;
    }
    HPCOMP_INLINE float color(const SpaceMaps &space, float q0, float q1, float *r, float *g, float *b) {
        const CielabNumbers &numbers = space.cielab;
        const float x = share_less_one(1 + q0 * 0.2f), z = share_less_one(1 - q1 * 0.5f);
        *r = sum_of(1, numbers.from_xz[0], x, z);
        *g = sum_of(1, numbers.from_xz[1], x, z);
        *b = sum_of(1, numbers.from_xz[2], x, z);
        return 1;
    }
    HPCOMP_INLINE float inverse_largest(const SpaceMaps &space) { return space.cielab.inverse_largest; }
};

template <class Space>
HPCOMP_INLINE void from_curve(const SpaceMaps &space, int n, const float *luminance, const float *p0,
                              const float *p1, float *red, float *green, float *blue) {
    for (int i = 0; i < n; ++i) {
        float q0, q1, r, g, b;
        chromaticity(luminance[i], p0[i], p1[i], Space::inverse_largest(space), &q0, &q1);
        const float size = luminance[i] / Space::color(space, q0, q1, &r, &g, &b);
        red[i] = r * size;
        green[i] = g * size;
        blue[i] = b * size;
    }
}

// --- back into gamut -----------------------------------------------------------------------------

// How often the interval that holds t is halved before a secant finds it: t is good to 1e-7.
constexpr int kHalvings = 10;

// Scales p of those of `n` colours that are beyond [lo, hi] and the slack of the space by the largest t that
// brings them there: hue and luminance stay.
template <class Space>
HPCOMP_INLINE void scale_p(const SpaceMaps &space, int n, const float *luminance, const float *p0,
                           const float *p1, const float *lo, const float *hi, float *red, float *green,
                           float *blue) {
    int outside[kBlock], count = 0;
    for (int i = 0; i < n; ++i) {
        const float most = largest_of(red[i], green[i], blue[i]);
        const float least = smallest_of(red[i], green[i], blue[i]);
        outside[count] = i;
        count += (luminance[i] > 0) & ((most > hi[i] + space.slack_hi * luminance[i]) |
                                           (least < lo[i] - space.slack_lo * luminance[i]));
    }
    if (count == 0) return;
    // At luminance 1.
    Plane q0, q1, below, above, near, far, excess_near, excess_far, t;
    for (int k = 0; k < count; ++k) {
        const int i = outside[k];
        chromaticity(luminance[i], p0[i], p1[i], Space::inverse_largest(space), &q0[k], &q1[k]);
        below[k] = lo[i] / luminance[i] - space.slack_lo;
        above[k] = hi[i] / luminance[i] + space.slack_hi;
    }
    // How far the colour of t*q is outside; below 0 inside.
    const auto excess = [&](int k, float share) {
        float r, g, b;
        const float y = Space::color(space, share * q0[k], share * q1[k], &r, &g, &b);
        return larger(largest_of(r, g, b) - above[k] * y, below[k] * y - smallest_of(r, g, b)) / y;
    };
    for (int k = 0; k < count; ++k) {
        near[k] = 0, far[k] = 1;
        excess_near[k] = excess(k, 0), excess_far[k] = excess(k, 1);
    }
    for (int halving = 0; halving < kHalvings; ++halving) {
        for (int k = 0; k < count; ++k) {
            const float middle = (near[k] + far[k]) * 0.5f, of_middle = excess(k, middle);
            const bool inside = of_middle <= 0;
            near[k] = inside ? middle : near[k];
            far[k] = inside ? far[k] : middle;
            excess_near[k] = inside ? of_middle : excess_near[k];
            excess_far[k] = inside ? excess_far[k] : of_middle;
        }
    }
    for (int k = 0; k < count; ++k) {
        const float across = excess_near[k] - excess_far[k];
        const float share = across < 0 ? clamped(excess_near[k] / across) : 0.0f;
        t[k] = near[k] + (far[k] - near[k]) * share;
    }
    for (int k = 0; k < count; ++k) {
        const int i = outside[k];
        float r, g, b;
        const float size = luminance[i] / Space::color(space, t[k] * q0[k], t[k] * q1[k], &r, &g, &b);
        red[i] = r * size;
        green[i] = g * size;
        blue[i] = b * size;
    }
}

// Colours of luminance and p that are beyond [lo, hi] come within it.
HPCOMP_INLINE void bring_within(const SpaceMaps &space, int n, const float *luminance, const float *p0,
                                const float *p1, const float *lo, const float *hi, float *red,
                                float *green, float *blue) {
    if (space.maps == Maps::kOklab) scale_p<Oklab>(space, n, luminance, p0, p1, lo, hi, red, green, blue);
    if (space.maps == Maps::kCielab) scale_p<Cielab>(space, n, luminance, p0, p1, lo, hi, red, green, blue);
    for (int i = 0; i < n; ++i) {
        const float y = luminance[i], above = larger(hi[i] - y, 0.0f), below = larger(y - lo[i], 0.0f);
        const float most = largest_of(red[i], green[i], blue[i]) - y;
        const float least = y - smallest_of(red[i], green[i], blue[i]);
        const float down = most > above ? above / most : 1.0f;
        const float t = smaller(down, least > below ? below / least : 1.0f);
        // What rounding leaves beyond them goes too, and so does -0.
        const auto inside = [=](float v) {
            return larger(smaller(t < 1 ? y + t * (v - y) : v, hi[i]), lo[i]) + 0.0f;
        };
        red[i] = inside(red[i]);
        green[i] = inside(green[i]);
        blue[i] = inside(blue[i]);
    }
}

// How far a colour of (Y, p) may be from the plain sum that it is, in largest channels, without a look at
// p, and with one; and how far p may be then, in luminances.
constexpr float kSameColor = 4e-6f, kNearColor = 1e-3f, kSameP = 1.2e-6f;

// The colours of a reduced stack within [lo, hi], in a space whose maps are not linear: red, green and
// blue come as the plain sum, and stay it where (+) did nothing else or where p is not finite.
HPCOMP_INLINE void to_color(const SpaceMaps &space, int n, const Light &light, const float *lo,
                            const float *hi) {
    Plane red, green, blue, p0, p1, blended, of_plain;
    const float *luminance = light.luminance;
    float inverse_largest = 0;
    switch (space.maps) {
    case Maps::kHsl: from_hsl(space, n, luminance, light.p0, light.p1, red, green, blue); break;
    case Maps::kOklab:
        inverse_largest = space.oklab.inverse_largest;
        from_curve<Oklab>(space, n, luminance, light.p0, light.p1, red, green, blue);
        break;
    case Maps::kCielab:
        inverse_largest = space.cielab.inverse_largest;
        from_curve<Cielab>(space, n, luminance, light.p0, light.p1, red, green, blue);
        break;
    case Maps::kLinear: return;
    }
    int unclear = 0;  // colours that rounding took far, or of which (Y, p) holds only a part
    for (int i = 0; i < n; ++i) {
        const float size = largest_of(magnitude(light.red[i]), magnitude(light.green[i]), magnitude(light.blue[i]));
        const float difference = largest_of(magnitude(red[i] - light.red[i]), magnitude(green[i] - light.green[i]),
                                            magnitude(blue[i] - light.blue[i]));
        const float p = larger(magnitude(light.p0[i]), magnitude(light.p1[i]));
        const bool finite = is_finite(light.p0[i], light.p1[i], luminance[i], size);
        blended[i] = finite & (difference > kSameColor * size) ? 1.0f : 0.0f;
        unclear += (blended[i] != 0) & ((difference < kNearColor * size) | (luminance[i] <= 0) |
                                        (p * inverse_largest > 0.7f * luminance[i]));
    }
    bring_within(space, n, luminance, light.p0, light.p1, lo, hi, red, green, blue);
    if (unclear) {
        for (int i = 0; i < n; ++i) of_plain[i] = luminance_of(space, light.red[i], light.green[i], light.blue[i]);
        to_p(space, n, light.red, light.green, light.blue, of_plain, p0, p1);
        for (int i = 0; i < n; ++i) {
            const float apart = larger(magnitude(p0[i] - light.p0[i]), magnitude(p1[i] - light.p1[i]));
            const float room = magnitude(luminance[i]) + larger(magnitude(p0[i]), magnitude(p1[i]));
            blended[i] = apart > kSameP * room ? blended[i] : 0.0f;
        }
    }
    for (int i = 0; i < n; ++i) {
        light.red[i] = blended[i] != 0 ? red[i] : light.red[i];
        light.green[i] = blended[i] != 0 ? green[i] : light.green[i];
        light.blue[i] = blended[i] != 0 ? blue[i] : light.blue[i];
    }
}

}  // namespace
}  // namespace hpcomp
