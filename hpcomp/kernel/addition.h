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

// p <- p (+) q: planes of n.
template <bool kBiased>
HPCOMP_INLINE void add_keeping_hue(const Rules &rules, int n, Row p0, Row p1, ConstRow q0, ConstRow q1) {
    Plane biased;
    if (kBiased) {
        // A loop of its own: with the shoulder in it, it would be too long to be vectorised.
        for (int i = 0; i < n; ++i) {
            const ScaledPair v = scaled_pair(p0[i], p1[i], q0[i], q1[i]);
            const float most = larger(v.m1, v.m2);
            const float share = smaller(v.m1, v.m2) / (most > 0 ? most : 1.0f);
            biased[i] = 1 - share * bias(rules, share);
        }
    }
    for (int i = 0; i < n; ++i) {
        const ScaledPair v = scaled_pair(p0[i], p1[i], q0[i], q1[i]);
        const float most = larger(v.m1, v.m2), least = smaller(v.m1, v.m2);
        const float plain = most > 0 ? (most - least) / most : 0.0f;  // [R3]
        const float kept = kBiased ? biased[i] : plain;
        const float x_differ = kept * (v.m1 >= v.m2 ? v.x1 : v.x2);   // [R2]
        const float y_differ = kept * (v.m1 >= v.m2 ? v.y1 : v.y2);
        const float e = shoulder(rules, v.x1, v.y1, v.x2, v.y2);      // [D3]
        p0[i] = (x_differ + e * (v.x1 + v.x2 - x_differ)) * v.up;
        p1[i] = (y_differ + e * (v.y1 + v.y2 - y_differ)) * v.up;
    }
}

// p <- p and q, `behind` it or in front of it, by the blending: planes of n.
HPCOMP_INLINE void add(const Rules &rules, int n, Row p0, Row p1, ConstRow q0, ConstRow q1,
                       bool behind = false) {
    switch (rules.blending) {
    case Blending::kHuePreserving:
        if (rules.gray_power > 0)
            add_keeping_hue<true>(rules, n, p0, p1, q0, q1);
        else
            add_keeping_hue<false>(rules, n, p0, p1, q0, q1);
        break;
    case Blending::kTraditional:
        for (int i = 0; i < n; ++i) {
            p0[i] += q0[i];
            p1[i] += q1[i];
        }
        break;
    case Blending::kForemost:
        for (int i = 0; i < n; ++i) {
            const bool p_has_hue = (p0[i] != 0) | (p1[i] != 0);
            const bool q_has_hue = (q0[i] != 0) | (q1[i] != 0);
            const bool stays = behind ? p_has_hue : !q_has_hue;
            p0[i] = stays ? p0[i] : q0[i];
            p1[i] = stays ? p1[i] : q1[i];
        }
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

// The larger of `part` and of what a rival cancels of a term, with the bias.
HPCOMP_INLINE void biased_part(const Rules &rules, ConstRow own, ConstRow rival, ConstRow hold,
                               ConstRow e, Row part) {
    for (int l = 0; l < kLanes; ++l) {
        const float strength = smaller(smaller(rival[l], hold[l]), own[l]);
        const float q = own[l] > 0 ? strength / own[l] : 0.0f;
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

// The simultaneous rule for one run of lanes: `n` terms of p (count, 2, kBlock), those of the numbers
// `there`, from column `begin` on. `pairs` holds `pair_floats`, `neighbors` an int for each
// pair and each term.
HPCOMP_INLINE void rivals_scaled_sum(const Rules &rules, const float *p, const int *there, int n,
                                     int begin, float *pairs, int *neighbors, float *sum0, float *sum1) {
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
    if (rules.gray_power > 0) {
        for (int i = 0; i < n; ++i) {
            float part[kLanes] = {};
            for (int j = 0; j < n; ++j)
                if (j != i)
                    biased_part(rules, pair(support, i, j), pair(support, j, i), hold + j * kLanes,
                                pair(e, i, j), part);
            ConstRow x = term(i), y = x + kBlock;
            for (int l = 0; l < kLanes; ++l) {
                sum0[l] += (1 - part[l]) * x[l];
                sum1[l] += (1 - part[l]) * y[l];
            }
        }
        return;
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

// The same for whatever number of terms. Which way a pixel goes depends on its own terms alone, so
// that those beside it change no bit of it.
HPCOMP_INLINE void sum_at_once(const Rules &rules, const float *p, int count, int begin, float *scratch,
                               float *sum0, float *sum1) {
    int *there = reinterpret_cast<int *>(scratch), *neighbors = there + count;
    scratch += number_floats(count);
    int own[kLanes];
    const int n = find_terms<kLanes>(p, count, begin, there, own);
    int sorted = 0;  // lanes whose terms are sorted by hue, not paired
    for (int l = 0; l < kLanes; ++l) sorted += own[l] > kPairedTerms;
    const bool together = n <= kTabledTerms;
    if (together && sorted < kLanes)
        rivals_scaled_sum(rules, p, there, n, begin, scratch, neighbors, sum0, sum1);
    if (together && sorted == 0) return;
    for (int l = 0; l < kLanes; ++l) {
        if (own[l] > kPairedTerms) {
            find_terms<1>(p, count, begin + l, there, own + l);
            sum_of_many(rules, p + begin + l, there, own[l], scratch, sum0 + l, sum1 + l);
        } else if (!together) {
            float all0[kLanes], all1[kLanes];
            find_terms<1>(p, count, begin + l, there, own + l);
            rivals_scaled_sum(rules, p, there, own[l], begin, scratch, neighbors, all0, all1);
            sum0[l] = all0[l];
            sum1[l] = all1[l];
        }
    }
}

// Reduces p (count, 2, kBlock) to its first term's place; `scratch` holds `reducing_floats`.
HPCOMP_INLINE void reduce_terms(const Rules &rules, float *p, int count, int n, float *scratch) {
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
            sum_at_once(rules, p, count, begin, scratch, sum0, sum1);
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

// The weights of the terms of a stack, and their sum of luminances. Of each layer come the factors
// F_A and F_B (count, kBlock), which are overwritten, its luminance and p.
HPCOMP_INLINE void weigh(int count, int n, float *f_a, const float *f_b, float *luminance, float *p,
                         float *sum) {
    // w_i = F_A,i times the F_B of the layers above, gathered from the top.
    Plane above;
    for (int i = 0; i < n; ++i) above[i] = 1;
    for (int k = count - 1; k >= 0; --k) {
        float *a = f_a + k * kBlock;
        const float *b = f_b + k * kBlock;
        float *p0 = p + int64_t(k) * 2 * kBlock, *p1 = p0 + kBlock;
        for (int i = 0; i < n; ++i) {
            const float weight = a[i] * above[i];
            above[i] *= b[i];
            luminance[k * kBlock + i] *= weight;
            p0[i] *= weight;
            p1[i] *= weight;
        }
    }
    for (int i = 0; i < n; ++i) sum[i] = 0;
    for (int k = 0; k < count; ++k)
        for (int i = 0; i < n; ++i) sum[i] += luminance[k * kBlock + i];  // [R1]
}

// What layer `k` and those below it do to each other's weights, and to the alpha so far.
HPCOMP_INLINE void factors(const Layer &layer, int k, int n, const float *alpha_layer, float *f_a,
                           float *f_b, float *alpha) {
    if (k == 0) {
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
