// How chroma is added: two terms with (+), + or by who is in front, and many in any order.

#pragma once

#include "floats.h"
#include "manyterms.h"

namespace hpcomp {
namespace {

constexpr double kPi = 3.14159265358979323846;

// The angle in [0, pi] of a vector whose y is not negative; 0 for the zero vector. A polynomial fit
// of atan(r)/r in r*r on [0, 1], good to 3e-8.
template <class Real>
HPCOMP_INLINE Real angle_of(Real y, Real x) {
    const Real across = magnitude(x);
    const Real longer = larger(across, y), shorter = smaller(across, y);
    const Real r = longer > 0 ? shorter / longer : Real(0);
    const Real q = r * r;
    Real slope = Real(0.0028340643f);
    slope = slope * q - Real(0.0160050305f);
    slope = slope * q + Real(0.0425876075f);
    slope = slope * q - Real(0.0749544544f);
    slope = slope * q + Real(0.106367541f);
    slope = slope * q - Real(0.142025705f);
    slope = slope * q + Real(0.199924836f);
    slope = slope * q - Real(0.333330668f);
    slope = slope * q + Real(0.999999984f);
    Real angle = slope * r;
    angle = y > across ? Real(kPi / 2) - angle : angle;
    return x < 0 ? Real(kPi) - angle : angle;
}

// 1 where two hues are equal, 0 where they differ, a smoothstep between.
HPCOMP_INLINE float shoulder(const Rules &rules, float x1, float y1, float x2, float y2) {
    const float angle = angle_of(magnitude(x1 * y2 - y1 * x2), x1 * x2 + y1 * y2);
    const float t = clamped(angle * rules.inverse_tolerance - 1);
    const float smooth = 1 - t * t * (3 - 2 * t);
    const float hard = angle <= rules.tolerance ? 1.0f : 0.0f;
    return rules.inverse_tolerance > 0 ? smooth : hard;
}

// A share in [0, 1] to the power 3b: what the bias b against grey, above 0, multiplies the share by
// that a rival cancels. In [0, 1], and 1 for a share of 1; their product is exact to 1e-7.
HPCOMP_INLINE float bias(const Rules &rules, float share) {
    // The share is 2^e * m with m around 1, and log2(m) an odd polynomial in (m - 1) / (m + 1).
    const uint32_t bits = bits_of(share);
    const int32_t e = int32_t(bits - 0x3f3504f3u) >> 23;  // of the root of a half
    const float m = float_of(bits - (uint32_t(e) << 23));
    const float s = (m - 1) / (m + 1);
    const float q = s * s;
    float slope = 0.431768588f;
    slope = slope * q + 0.576713087f;
    slope = slope * q + 0.96179886f;
    slope = slope * q + 2.88539008f;
    const float y = (float(e) + slope * s) * rules.gray_power;
    // 2^y, its whole part as an exponent and the rest as a polynomial.
    const float bounded = larger(smaller(y, 0.0f), -126.0f);
    constexpr float kRounder = 12582912.0f;  // 1.5 * 2^23: adding it rounds to an integer
    const float whole = (bounded + kRounder) - kRounder;
    const float rest = bounded - whole;
    float power = 0.000153533856f;
    power = power * rest + 0.00133988722f;
    power = power * rest + 0.00961843726f;
    power = power * rest + 0.0555033248f;
    power = power * rest + 0.240226479f;
    power = power * rest + 0.693147203f;
    power = power * rest + 1.0f;
    return at_most_one(power * float_of(uint32_t(int32_t(whole) + 127) << 23));
}

// Two vectors scaled by one power of two, and their lengths.
struct ScaledPair {
    float x1, y1, x2, y2, m1, m2, up;
};
HPCOMP_INLINE ScaledPair scaled_pair(float p0, float p1, float q0, float q1) {
    const Scale scale = scale_of(p0, p1, q0, q1);
    const float x1 = p0 * scale.down, y1 = p1 * scale.down;
    const float x2 = q0 * scale.down, y2 = q1 * scale.down;
    return {x1, y1, x2, y2, __builtin_sqrtf(x1 * x1 + y1 * y1), __builtin_sqrtf(x2 * x2 + y2 * y2),
            scale.up};
}

// The strengths of two p that compete: their lengths where nothing else is given, or both are 0.
template <bool kStrong>
HPCOMP_INLINE void competing(const ScaledPair &v, const float *m1, const float *m2, int i, float *first,
                             float *second) {
    const bool by_length = !kStrong || (m1[i] == 0 && m2[i] == 0);
    *first = by_length ? v.m1 : m1[i];
    *second = by_length ? v.m2 : m2[i];
}

// What (+) keeps of two p, factors in [0, 1]: planes of n. Where one is not finite all is kept. `m1`, `m2`:
// their strengths, where `kStrong` says that they have some.
template <bool kBiased, bool kStrong>
HPCOMP_INLINE void keep_hue(const Rules &rules, int n, ConstRow p0, ConstRow p1, ConstRow q0, ConstRow q1,
                            const float *m1, const float *m2, Row a, Row b) {
    Plane biased;
    if (kBiased) {
        // A loop of its own: with the shoulder in it, it would be too long to be vectorised.
        for (int i = 0; i < n; ++i) {
            const ScaledPair v = scaled_pair(p0[i], p1[i], q0[i], q1[i]);
            float first, second;
            competing<kStrong>(v, m1, m2, i, &first, &second);
            const float most = larger(first, second);
            const float share = smaller(first, second) / (most > 0 ? most : 1.0f);
            biased[i] = 1 - share * bias(rules, share);
        }
    }
    for (int i = 0; i < n; ++i) {
        const ScaledPair v = scaled_pair(p0[i], p1[i], q0[i], q1[i]);
        float of_first, of_second;
        competing<kStrong>(v, m1, m2, i, &of_first, &of_second);
        const float most = larger(of_first, of_second), least = smaller(of_first, of_second);
        const float plain = most > 0 ? (most - least) / most : 0.0f;  // [R3]
        const float differ = kBiased ? biased[i] : plain;
        const float e = shoulder(rules, v.x1, v.y1, v.x2, v.y2);      // [D3]
        const float kept = at_most_one(differ + e * (1 - differ));
        const bool first = of_first >= of_second;                     // [R2]
        const bool finite = is_finite(p0[i], p1[i], q0[i], q1[i]) & (!kStrong || most * 0 == 0);
        a[i] = finite ? (first ? kept : e) : 1.0f;
        b[i] = finite ? (first ? e : kept) : 1.0f;
    }
}

// The chroma of some terms, planes of n; `m` is null where what competes is the length of p.
struct ChromaPlanes {
    const float *p0, *p1, *m;
};

// What the blending keeps of p and of q, which is `behind` it or in front of it: planes of n.
HPCOMP_INLINE void keep(const Rules &rules, int n, const ChromaPlanes &p, const ChromaPlanes &q, bool behind,
                        Row a, Row b) {
    ConstRow p0 = p.p0, p1 = p.p1, q0 = q.p0, q1 = q.p1;
    const bool strong = p.m != nullptr;
    switch (rules.blending) {
    case Blending::kHuePreserving:
        if (rules.gray_power > 0) {
            if (strong) keep_hue<true, true>(rules, n, p0, p1, q0, q1, p.m, q.m, a, b);
            else keep_hue<true, false>(rules, n, p0, p1, q0, q1, nullptr, nullptr, a, b);
        } else {
            if (strong) keep_hue<false, true>(rules, n, p0, p1, q0, q1, p.m, q.m, a, b);
            else keep_hue<false, false>(rules, n, p0, p1, q0, q1, nullptr, nullptr, a, b);
        }
        break;
    case Blending::kWoven:  // which does not add two by two
    case Blending::kTraditional:
        for (int i = 0; i < n; ++i) a[i] = b[i] = 1;
        break;
    case Blending::kForemost:
        for (int i = 0; i < n; ++i) {
            const bool p_has_hue = (p0[i] != 0) | (p1[i] != 0);
            const bool q_has_hue = (q0[i] != 0) | (q1[i] != 0);
            const bool stays = behind ? p_has_hue : !q_has_hue;
            const bool finite = is_finite(p0[i], p1[i], q0[i], q1[i]);
            a[i] = (stays | !finite) ? 1.0f : 0.0f;
            b[i] = (!stays | !finite) ? 1.0f : 0.0f;
        }
    }
}

// p <- p and q, of which a and b are kept, and so their strengths if there are some: planes of n. What has
// no hue left has no strength.
HPCOMP_INLINE void add_kept(int n, float *p0, float *p1, float *m, const ChromaPlanes &q, ConstRow a, ConstRow b) {
    const float *q0 = q.p0, *q1 = q.p1, *more = q.m;
#pragma GCC ivdep
    for (int i = 0; i < n; ++i) {
        p0[i] = a[i] * p0[i] + b[i] * q0[i];
        p1[i] = a[i] * p1[i] + b[i] * q1[i];
    }
    if (m == nullptr) return;
#pragma GCC ivdep
    for (int i = 0; i < n; ++i)
        m[i] = (p0[i] != 0) | (p1[i] != 0) ? a[i] * m[i] + b[i] * more[i] : 0.0f;
}

// p <- p and q by the blending, whose strengths are their lengths: planes of n.
HPCOMP_INLINE void add(const Rules &rules, int n, float *p0, float *p1, const float *q0, const float *q1,
                       bool behind) {
    Plane a, b;
    const ChromaPlanes added{q0, q1, nullptr};
    keep(rules, n, {p0, p1, nullptr}, added, behind, a, b);
    add_kept(n, p0, p1, nullptr, added, a, b);
}

// Colours times one plane, others times another, and the same more of each channel: planes of n.
HPCOMP_INLINE void mix_colors(int n, const Light &to, ConstRow kept, const Light &from, ConstRow kept_from,
                              ConstRow more) {
    float *red = to.red, *green = to.green, *blue = to.blue;
    const float *r = from.red, *g = from.green, *b = from.blue;
#pragma GCC ivdep
    for (int i = 0; i < n; ++i) {
        red[i] = (kept[i] * red[i] + kept_from[i] * r[i]) + more[i];
        green[i] = (kept[i] * green[i] + kept_from[i] * g[i]) + more[i];
        blue[i] = (kept[i] * blue[i] + kept_from[i] * b[i]) + more[i];
    }
}

// to <- to and `from`, by the blending and each with its weight: planes of n. What is not kept of a colour
// becomes grey, none of it below 0 where no luminance is.
HPCOMP_INLINE void add(const Rules &rules, int n, const Light &to, const float *weight, const Light &from,
                       const float *weight_from, bool behind) {
    const bool linear = rules.maps == Maps::kLinear;
    float *luminance = to.luminance, *p0 = to.p0, *p1 = to.p1;
    const float *y = from.luminance, *q0 = from.p0, *q1 = from.p1;
    Plane z0, z1, z_strength, a, b, kept, kept_from, grey;
    if (linear && rules.blending == Blending::kTraditional) {  // of which nobody asks p
        for (int i = 0; i < n; ++i) grey[i] = 0;
        mix_colors(n, to, weight, from, weight_from, grey);
        for (int i = 0; i < n; ++i) luminance[i] = weight[i] * luminance[i] + weight_from[i] * y[i];
        return;
    }
    float *m = to.strength;
    const float *more = from.strength;
    for (int i = 0; i < n; ++i) {
        p0[i] = weight[i] * p0[i];
        p1[i] = weight[i] * p1[i];
        z0[i] = weight_from[i] * q0[i];
        z1[i] = weight_from[i] * q1[i];
    }
    for (int i = 0; m && i < n; ++i) {
        m[i] *= weight[i];
        z_strength[i] = weight_from[i] * more[i];
    }
    const ChromaPlanes added{z0, z1, m ? z_strength : nullptr};
    keep(rules, n, {p0, p1, m}, added, behind, a, b);
    add_kept(n, p0, p1, m, added, a, b);
    if (!linear) {  // the plain sum
        for (int i = 0; i < n; ++i) luminance[i] = weight[i] * luminance[i] + weight_from[i] * y[i];
        for (int i = 0; i < n; ++i) grey[i] = 0;
        mix_colors(n, to, weight, from, weight_from, grey);
        return;
    }
#pragma GCC ivdep
    for (int i = 0; i < n; ++i) {
        const float of_to = weight[i] * luminance[i], of_from = weight_from[i] * y[i];
        kept[i] = a[i] * weight[i];
        kept_from[i] = b[i] * weight_from[i];
        // Where all is kept nothing is lost, of what is infinite neither.
        const float lost = of_to - kept[i] * luminance[i], lost_from = of_from - kept_from[i] * y[i];
        grey[i] = (a[i] == 1 ? 0.0f : lost) + (b[i] == 1 ? 0.0f : lost_from);
        luminance[i] = of_to + of_from;  // [R1]
    }
    mix_colors(n, to, kept, from, kept_from, grey);
}

HPCOMP_INLINE void factor(Factor kind, const float *alpha, int n, float *out) {
    switch (kind) {
    case Factor::kZero: for (int i = 0; i < n; ++i) out[i] = 0; break;
    case Factor::kOne: for (int i = 0; i < n; ++i) out[i] = 1; break;
    case Factor::kAlpha: for (int i = 0; i < n; ++i) out[i] = alpha[i]; break;
    case Factor::kRest: for (int i = 0; i < n; ++i) out[i] = 1 - alpha[i]; break;
    }
}

// Above what rounding changes in the products of two vectors of lengths up to 3.
constexpr float kCloseMargin = 1e-4f;

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

// The larger of `part` and of what a rival cancels of a term, with the bias; all of what nothing backs.
template <bool kWeak>
HPCOMP_INLINE void biased_part(const Rules &rules, ConstRow own, ConstRow rival, ConstRow hold,
                               ConstRow e, Row part) {
    for (int l = 0; l < kLanes; ++l) {
        const float strength = smaller(smaller(rival[l], hold[l]), own[l]);
        const float unbacked = kWeak && smaller(rival[l], hold[l]) > 0 ? 1.0f : 0.0f;
        const float q = own[l] > 0 ? strength / own[l] : unbacked;
        part[l] = larger((1 - e[l]) * (q * bias(rules, q)), part[l]);
    }
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

// Which terms p (count, 2, kBlock) have chroma in one of the lanes from column `begin` on: how many, and
// in `there` their numbers. `own` counts those of each lane.
template <int kCount>
HPCOMP_INLINE int find_terms(const float *p, int count, int begin, int *there, int *own) {
    int n = 0;
    for (int l = 0; l < kCount; ++l) own[l] = 0;
    for (int k = 0; k < count; ++k) {
        ConstRow x = p + int64_t(k) * 2 * kBlock + begin, y = x + kBlock;
        int any = 0;
        for (int l = 0; l < kCount; ++l) {
            const int has_chroma = (x[l] != 0) | (y[l] != 0);
            own[l] += has_chroma;
            any |= has_chroma;
        }
        there[n] = k;
        n += any;
    }
    return n;
}

// All is kept of what has no hue: `kept` (n, kLanes).
HPCOMP_INLINE void keep_greys(const float *unit_x, const float *unit_y, int n, float *kept) {
    for (int i = 0; i < n * kLanes; ++i) kept[i] = (unit_x[i] != 0) | (unit_y[i] != 0) ? kept[i] : 1.0f;
}

// What competes in a run of lanes: strengths (count, kBlock) instead of the lengths `m` (n, kLanes) of terms,
// from column `begin` on and scaled by one power of two a pixel, but where all of a pixel are 0. Returns
// whether a hue of a pixel where others have strength has none itself.
HPCOMP_INLINE bool take_strengths(const float *strengths, const int *there, int n, int begin, float *m) {
    const Lanes none = {};
    int weak = 0;
    for (int l = 0; l < kLanes; l += kRegister) {
        Lanes largest = {};
        for (int k = 0; k < n; ++k) {
            const Lanes of = lanes_of(strengths + int64_t(there[k]) * kBlock + begin + l);
            const Lanes own = lanes_of(m + k * kLanes + l) > none ? of : none;
            largest = own > largest ? own : largest;
        }
        float down[kRegister], size[kRegister];
        std::memcpy(size, &largest, sizeof size);
        for (int i = 0; i < kRegister; ++i) down[i] = scale_of(size[i], 0, 0, 0).down;
        const Lanes scale = lanes_of(down);
        Lanes without = {};
        for (int k = 0; k < n; ++k) {
            const Lanes length = lanes_of(m + k * kLanes + l);
            const Lanes of = lanes_of(strengths + int64_t(there[k]) * kBlock + begin + l) * scale;
            const Lanes own = length > none ? of : none;
            without += length > none ? (own > none ? none : none + 1.0f) : none;
            const Lanes competing = largest > none ? own : length;
            std::memcpy(m + k * kLanes + l, &competing, sizeof competing);
        }
        float counts[kRegister];
        std::memcpy(counts, &without, sizeof counts);
        for (int i = 0; i < kRegister; ++i) weak |= counts[i] != 0;
    }
    return weak != 0;
}

// What the strongest rival leaves of each term, without a bias: `kept` (n, kLanes), from the supports (n, n,
// kLanes), the shoulders `e` (n, n, kLanes) and what hues hold (n, kLanes). `kWeak`: a hue may have no strength,
// and all of it gives way to one that has some.
template <bool kWeak>
HPCOMP_INLINE void keep_of_rivals(const float *e, const float *support, const float *hold, int n, float *kept) {
    const auto pair = [n](const float *table, int i, int k) { return table + (int64_t(i) * n + k) * kLanes; };
    for (int l = 0; l < kLanes; l += kRegister) {
        for (int i = 0; i < n; ++i) {
            // The strongest rival's (1 - e) q as a fraction: compared without dividing.
            Lanes part = {}, whole = part + 1.0f;
            for (int j = 0; j < n; ++j) {
                if (j == i) continue;
                Lanes own = lanes_of(pair(support, i, j) + l);
                Lanes other = smaller(lanes_of(pair(support, j, i) + l), lanes_of(hold + j * kLanes + l));
                if (kWeak) {
                    const Lanes none = {}, all = none + 1.0f;
                    const auto unbacked = own == none;
                    other = unbacked ? (other > none ? all : none) : other;
                    own = unbacked ? all : own;
                }
                const Lanes weight = (1.0f - lanes_of(pair(e, i, j) + l)) * smaller(other, own);
                const auto stronger = weight * whole > part * own;
                part = stronger ? weight : part;
                whole = stronger ? own : whole;
            }
            const Lanes scaled = 1.0f - part / whole;
            std::memcpy(kept + i * kLanes + l, &scaled, sizeof scaled);
        }
    }
}

// The same with the bias.
template <bool kWeak>
HPCOMP_INLINE void keep_of_rivals_biased(const Rules &rules, const float *e, const float *support, const float *hold,
                                         int n, float *kept) {
    const auto pair = [n](const float *table, int i, int k) { return table + (int64_t(i) * n + k) * kLanes; };
    for (int i = 0; i < n; ++i) {
        float part[kLanes] = {};
        for (int j = 0; j < n; ++j)
            if (j != i)
                biased_part<kWeak>(rules, pair(support, i, j), pair(support, j, i), hold + j * kLanes,
                                   pair(e, i, j), part);
        for (int l = 0; l < kLanes; ++l) kept[i * kLanes + l] = 1 - part[l];
    }
}

// The simultaneous rule for one run of lanes: `kept` (n, kLanes) gets what it keeps of `n` terms of
// p (count, 2, kBlock), those of the numbers `there`, from column `begin` on. `strengths` (count, kBlock):
// what competes, where `kStrong` says that it is not their lengths. `pairs` holds `pair_floats`,
// `neighbors` an int for each pair and each term.
template <bool kStrong>
HPCOMP_INLINE void keep_beside_rivals(const Rules &rules, const float *p, const float *strengths,
                                      const int *there, int n, int begin, float *pairs, int *neighbors,
                                      float *kept) {
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
    const bool weak = kStrong && take_strengths(strengths, there, n, begin, m);
    // Most hues differ, and then their shoulder is 0 without its angle: `neighbors` lists the
    // others of each term, itself first, in which alone its support has anything.
    int *degree = neighbors + int64_t(n) * n;
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
    const bool biased = rules.gray_power > 0;
    if (weak) {
        if (biased) keep_of_rivals_biased<true>(rules, e, support, hold, n, kept);
        else keep_of_rivals<true>(e, support, hold, n, kept);
        keep_greys(unit_x, unit_y, n, kept);
    } else {
        if (biased) keep_of_rivals_biased<false>(rules, e, support, hold, n, kept);
        else keep_of_rivals<false>(e, support, hold, n, kept);
    }
}

// The same for whatever number of terms: `kept` (count, kBlock) gets all factors, from column `begin` on.
// Which way a pixel goes depends on its own terms alone, so that those beside it change no bit of it.
template <bool kStrong>
HPCOMP_INLINE void keep_at_once(const Rules &rules, const float *p, const float *strengths, int count,
                                int begin, float *scratch, float *kept) {
    int *there = reinterpret_cast<int *>(scratch), *neighbors = there + count;
    scratch += number_floats(count);
    kept += begin;
    for (int k = 0; k < count; ++k)
        for (int l = 0; l < kLanes; ++l) kept[k * kBlock + l] = 1;
    int own[kLanes];
    float of_few[kTabledTerms * kLanes];
    const int n = find_terms<kLanes>(p, count, begin, there, own);
    int sorted = 0;  // lanes whose terms are sorted by hue, not paired
    for (int l = 0; l < kLanes; ++l) sorted += own[l] > kPairedTerms;
    const bool together = n <= kTabledTerms;
    if (together && sorted < kLanes) {
        keep_beside_rivals<kStrong>(rules, p, strengths, there, n, begin, scratch, neighbors, of_few);
        for (int k = 0; k < n; ++k)
            std::memcpy(kept + there[k] * kBlock, of_few + k * kLanes, kLanes * sizeof(float));
    }
    for (int l = 0; l < kLanes && !(together && sorted == 0); ++l) {
        if (together && own[l] <= kPairedTerms) continue;
        find_terms<1>(p, count, begin + l, there, own + l);
        if (own[l] > kPairedTerms) {
            double *terms = reinterpret_cast<double *>(scratch), *factors = terms + 2 * int64_t(own[l]);
            double *of_terms = factors + own[l];
            for (int k = 0; k < own[l]; ++k) {
                const float *term = p + int64_t(there[k]) * 2 * kBlock + begin + l;
                terms[2 * int64_t(k)] = double(term[0]), terms[2 * int64_t(k) + 1] = double(term[kBlock]);
                if (kStrong) of_terms[k] = double(strengths[int64_t(there[k]) * kBlock + begin + l]);
                factors[k] = 1;
            }
            keep_of_many(rules, terms, kStrong ? of_terms : nullptr, own[l], of_terms + own[l], factors);
            for (int k = 0; together && k < count; ++k) kept[k * kBlock + l] = 1;
            for (int k = 0; k < own[l]; ++k) kept[there[k] * kBlock + l] = float(factors[k]);
        } else {
            keep_beside_rivals<kStrong>(rules, p, strengths, there, own[l], begin, scratch, neighbors, of_few);
            for (int k = 0; k < own[l]; ++k) kept[there[k] * kBlock + l] = of_few[k * kLanes + l];
        }
    }
    // Where a term is not finite, all is kept.
    float unknown[kLanes] = {};
    for (int k = 0; k < count; ++k) {
        ConstRow x = p + int64_t(k) * 2 * kBlock + begin, y = x + kBlock;
        for (int l = 0; l < kLanes; ++l) unknown[l] += x[l] * 0 + y[l] * 0;
        if (!kStrong) continue;
        ConstRow m = strengths + int64_t(k) * kBlock + begin;
        for (int l = 0; l < kLanes; ++l) unknown[l] += m[l] * 0;
    }
    int any = 0;
    for (int l = 0; l < kLanes; ++l) any |= unknown[l] != 0;
    for (int k = 0; any && k < count; ++k)
        for (int l = 0; l < kLanes; ++l) kept[k * kBlock + l] = unknown[l] == 0 ? kept[k * kBlock + l] : 1.0f;
}

// The pairs in which `count` terms are added one by one, in their sequence: the right one to the left one,
// where the sum is then. Each term is a right one once, but for `root`, in which all ends.
struct Pairs {
    const int *left, *right;
    int count, root;
};

// Of terms of the layers `numbers`, in rising order. Which pair they are in depends on these alone: a layer that
// is not there changes no other's. `scratch` holds two ints a term and one a layer.
HPCOMP_INLINE Pairs pairs_of(const Rules &rules, const int *numbers, int count, int *scratch) {
    int *left = scratch, *right = left + count, *terms = right + count, pairs = 0;
    const auto add_pair = [&](int l, int r) { left[pairs] = l, right[pairs++] = r; };
    if (rules.order != Order::kBalanced) {
        for (int layer = 0; layer < rules.layers; ++layer) terms[layer] = -1;
        for (int k = 0; k < count; ++k) terms[numbers[k]] = k;
        int root = -1;
        for (int turn = 0; turn < rules.layers; ++turn) {
            const int k = terms[rules.permutation[turn]];
            if (k < 0) continue;
            if (root < 0) root = k;
            else add_pair(root, k);
        }
        return {left, right, pairs, root};
    }
    // Neighbours pair level by level; an odd one is carried up.
    for (int k = 0; k < count; ++k) terms[k] = k;
    for (int bit = 1, n = count; n > 1; ++bit) {
        int sums = 0;
        for (int i = 0; i < n; ++i) {
            const int k = terms[i];
            if (i + 1 < n && numbers[k] >> bit == numbers[terms[i + 1]] >> bit) add_pair(k, terms[++i]);
            terms[sums++] = k;
        }
        n = sums;
    }
    return {left, right, pairs, 0};
}

// The sum of terms p (count, 2, kBlock) of which `kept` (count, kBlock) is kept, in the place of the first.
HPCOMP_INLINE void sum_kept(float *p, const float *kept, int count, int begin) {
    float sum0[kLanes] = {}, sum1[kLanes] = {};
    for (int k = 0; k < count; ++k) {
        const float *p0 = p + int64_t(k) * 2 * kBlock + begin, *factor = kept + int64_t(k) * kBlock + begin;
        for (int l = 0; l < kLanes; ++l) sum0[l] += factor[l] * p0[l];
        for (int l = 0; l < kLanes; ++l) sum1[l] += factor[l] * p0[kBlock + l];
    }
    std::memcpy(p + begin, sum0, sizeof sum0);
    std::memcpy(p + kBlock + begin, sum1, sizeof sum1);
}

// The same of their strengths (count, kBlock), after that of p: what has no hue left has none.
HPCOMP_INLINE void sum_kept_strengths(const float *p, float *strengths, const float *kept, int count, int begin) {
    float sum[kLanes] = {};
    for (int k = 0; k < count; ++k) {
        ConstRow m = strengths + int64_t(k) * kBlock + begin, factor = kept + int64_t(k) * kBlock + begin;
        for (int l = 0; l < kLanes; ++l) sum[l] += factor[l] * m[l];
    }
    ConstRow p0 = p + begin, p1 = p + kBlock + begin;
    Row m = strengths + begin;
    for (int l = 0; l < kLanes; ++l) m[l] = (p0[l] != 0) | (p1[l] != 0) ? sum[l] : 0.0f;
}

// Reduces weighted p (count, 2, kBlock) of the layers `numbers`, and their strengths (count, kBlock) if they have
// some, to the place of the first, and tells in `kept` (count, kBlock) what is kept of each term; `kept` also is
// scratch, as are `of_left` (count, kBlock) and `scratch`, which holds `reducing_floats` of all layers.
HPCOMP_INLINE void reduce_terms(const Rules &rules, const int *numbers, float *p, float *strengths, int count,
                                int n, float *kept, float *of_left, float *scratch) {
    const auto x = [p](int k) { return p + int64_t(k) * 2 * kBlock; };
    const auto m = [strengths](int k) { return strengths ? strengths + int64_t(k) * kBlock : nullptr; };
    if (rules.order == Order::kSimultaneous) {
        for (int begin = 0; begin < n; begin += kLanes) {
            if (strengths) {
                keep_at_once<true>(rules, p, strengths, count, begin, scratch, kept);
                sum_kept(p, kept, count, begin);
                sum_kept_strengths(p, strengths, kept, count, begin);
            } else {
                keep_at_once<false>(rules, p, nullptr, count, begin, scratch, kept);
                sum_kept(p, kept, count, begin);
            }
        }
        return;
    }
    const Pairs pairs = pairs_of(rules, numbers, count, reinterpret_cast<int *>(scratch));
    for (int i = 0; i < pairs.count; ++i) {
        const int left = pairs.left[i], right = pairs.right[i];
        Row a = of_left + int64_t(right) * kBlock, b = kept + int64_t(right) * kBlock;
        const ChromaPlanes added{x(right), x(right) + kBlock, m(right)};
        keep(rules, n, {x(left), x(left) + kBlock, m(left)}, added, false, a, b);
        add_kept(n, x(left), x(left) + kBlock, m(left), added, a, b);
    }
    const int root = pairs.root;
    for (int i = 0; i < n; ++i) kept[int64_t(root) * kBlock + i] = 1;
    for (int i = pairs.count - 1; i >= 0; --i) {
        Row of_sum = kept + int64_t(pairs.left[i]) * kBlock, b = kept + int64_t(pairs.right[i]) * kBlock;
        ConstRow a = of_left + int64_t(pairs.right[i]) * kBlock;
        for (int j = 0; j < n; ++j) {
            b[j] *= of_sum[j];
            of_sum[j] *= a[j];
        }
    }
    if (root == 0) return;
    std::memcpy(x(0), x(root), 2 * sizeof(Plane));
    if (strengths) std::memcpy(m(0), m(root), sizeof(Plane));
}

// The weights of the terms of a stack. Of each layer come the factors F_A and F_B (count, kBlock); F_A
// becomes its weight, which p (count, 2, kBlock) takes, and the strengths (count, kBlock) if there are some.
HPCOMP_INLINE void weigh(int count, int n, float *f_a, const float *f_b, float *p, float *strengths = nullptr) {
    // w_i = F_A,i times the F_B of the layers above, gathered from the top.
    Plane above;
    for (int i = 0; i < n; ++i) above[i] = 1;
    for (int k = count - 1; k >= 0; --k) {
        Row weight = f_a + int64_t(k) * kBlock, p0 = p + int64_t(k) * 2 * kBlock, p1 = p0 + kBlock;
        ConstRow b = f_b + int64_t(k) * kBlock;
        for (int i = 0; i < n; ++i) {
            weight[i] *= above[i];
            above[i] *= b[i];
            p0[i] *= weight[i];
            p1[i] *= weight[i];
        }
        if (strengths == nullptr) continue;
        Row m = strengths + int64_t(k) * kBlock;
        for (int i = 0; i < n; ++i) m[i] *= weight[i];
    }
}

// What a layer and those below it do to each other's weights, and to the alpha so far.
HPCOMP_INLINE void factors(const Layer &layer, int number, int n, const float *alpha_layer, float *f_a,
                           float *f_b, float *alpha) {
    if (number == 0) {
        for (int i = 0; i < n; ++i) f_a[i] = 1, f_b[i] = 0, alpha[i] = alpha_layer[i];
        return;
    }
    factor(layer.factor_a, alpha, n, f_a);
    factor(layer.factor_b, alpha_layer, n, f_b);
    for (int i = 0; i < n; ++i)
        alpha[i] = at_most_one(f_a[i] * alpha_layer[i] + f_b[i] * alpha[i]);
}

}  // namespace
}  // namespace hpcomp
