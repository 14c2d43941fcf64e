// Woven terms: the phases of the pattern, and in each pixel whose hue it shows.

#pragma once

#include "addition.h"

namespace hpcomp {
namespace {

constexpr double kStripeShift = 0.618034, kLargestPhase = 1 - 0x1p-24;

HPCOMP_INLINE int floor_of_quotient(int a, int b) { return a / b - (a % b < 0 ? 1 : 0); }

// Of a block from column `x`, row `y` of the canvas on, as `weaving.py` has them. Divisions are for cells,
// not for pixels.
void phases(const Weave &weave, int x, int y, Row phase) {
    const bool stripes = weave.pattern == Pattern::kStripes;
    const int along = stripes ? x + y : x, size = weave.size;
    int cell = floor_of_quotient(along, size), step = along - cell * size;
    const auto wrapped = [&weave](int of) { return of - floor_of_quotient(of, weave.side) * weave.side; };
    const uint16_t *row = nullptr;
    if (!stripes) row = weave.tile + int64_t(wrapped(floor_of_quotient(y, size))) * weave.side;
    for (int begin = 0; begin < kBlock; ++cell) {
        const int end = kBlock - begin < size - step ? kBlock : begin + size - step;
        if (stripes) {
            const double moved = kStripeShift * cell + 0.5, shift = moved - __builtin_floor(moved);
            for (int i = begin; i < end; ++i)
                phase[i] = float(smaller((double(step + i - begin) + shift) / size, kLargestPhase));
        } else {
            const double of_cell = (double(row[wrapped(cell)]) + 0.5) / (double(weave.side) * weave.side);
            for (int i = begin; i < end; ++i) phase[i] = float(smaller(of_cell, kLargestPhase));
        }
        begin = end, step = 0;
    }
}

typedef int32_t LaneInts __attribute__((vector_size(kRegister * sizeof(int32_t))));
// Bits of the number of a hue, and how many of them are found among all terms.
constexpr int kHueBits = 24, kCoarseBits = 8;
// Units of all strength: their sums are exact as floats, too.
constexpr float kShares = 1 << 23;
// Terms up to which each is compared with all others.
constexpr int kFewTerms = 16;

// A number that grows with the angle of a vector, from -pi to pi: no arc is taken, and hues that rounding
// alone tells apart mostly have one number. 0 has whatever number.
HPCOMP_INLINE int32_t hue_number(float x, float y) {
    const float size = magnitude(x) + magnitude(y), slope = size > 0 ? y / size : 0.0f;
    const float far = y < 0 ? -2 - slope : 2 - slope;
    const float turn = x < 0 ? far : slope;  // in [-2, 2]
    const int32_t number = int32_t((turn + 2) * float(1 << (kHueBits - 2)));
    return number < (1 << kHueBits) ? number : (1 << kHueBits) - 1;
}

// Terms of a run of lanes: (n, kLanes) each. `hue`: its number. `share`: the strength in whole units, so that
// their sums are exact, whatever the terms beside. `x`, `y`: p scaled near 1.
struct WovenTerms {
    int n;
    float *m, *length, *x, *y;
    int32_t *hue, *share;
    int *close;  // (n): scratch for numbers of terms

    WovenTerms(float *scratch, int n) : n(n) {
        const int64_t plane = int64_t(n) * kLanes;
        m = scratch, length = m + plane, x = length + plane, y = x + plane;
        hue = reinterpret_cast<int32_t *>(y + plane), share = hue + plane;
        close = share + plane;
    }

    LaneInts lanes(const int32_t *of, int k, int r) const {
        LaneInts lanes;
        std::memcpy(&lanes, of + int64_t(k) * kLanes + r * kRegister, sizeof lanes);
        return lanes;
    }
};

// All lanes in one loop: additions wait for each other.
constexpr int kRegisters = kLanes / kRegister;
struct LaneSums {
    LaneInts part[kRegisters];
};

// The sums of the shares of all terms whose hue is below `trial`.
HPCOMP_INLINE LaneSums shares_below(const WovenTerms &terms, const LaneSums &trial) {
    LaneSums sums{};
    for (int k = 0; k < terms.n; ++k)
        for (int r = 0; r < kRegisters; ++r)
            sums.part[r] += (terms.lanes(terms.hue, k, r) < trial.part[r]) & terms.lanes(terms.share, k, r);
    return sums;
}

// Of the `close` ones (count) alone, whose hue is from `from` on.
HPCOMP_INLINE LaneSums shares_below(const WovenTerms &terms, int count, const LaneSums &trial,
                                    const LaneSums &from) {
    LaneSums sums{};
    for (int c = 0; c < count; ++c) {
        for (int r = 0; r < kRegisters; ++r) {
            const LaneInts hue = terms.lanes(terms.hue, terms.close[c], r);
            sums.part[r] +=
                (hue < trial.part[r]) & (hue >= from.part[r]) & terms.lanes(terms.share, terms.close[c], r);
        }
    }
    return sums;
}

// Puts into `close` the terms whose hue has the first bits of `coarse` in any lane. Returns how many.
HPCOMP_INLINE int close_terms(const WovenTerms &terms, const LaneSums &coarse, int other_bits) {
    int count = 0;
    for (int k = 0; k < terms.n; ++k) {
        LaneInts any = {};
        for (int r = 0; r < kRegisters; ++r)
            any |= (terms.lanes(terms.hue, k, r) ^ coarse.part[r]) >> other_bits == 0;
        int is_close = 0;
        for (int l = 0; l < kRegister; ++l) is_close |= any[l];
        terms.close[count] = k;
        count += is_close != 0;
    }
    return count;
}

// The term of each lane with which the shares, by hue and then by number, pass the target: its number, -1 for
// none, its p scaled near 1, and its length.
struct Thread {
    int32_t number[kLanes];
    float x[kLanes], y[kLanes], length[kLanes];

    HPCOMP_INLINE void take(const WovenTerms &terms, int k, const int32_t (&takes)[kLanes], Thread &thread) {
        ConstRow x = terms.x + k * kLanes, y = terms.y + k * kLanes, lengths = terms.length + k * kLanes;
        for (int l = 0; l < kLanes; ++l) {
            thread.number[l] = takes[l] ? k : thread.number[l];
            thread.x[l] = takes[l] ? x[l] : thread.x[l];
            thread.y[l] = takes[l] ? y[l] : thread.y[l];
            thread.length[l] = takes[l] ? lengths[l] : thread.length[l];
        }
    }
};

// Of few terms: what each reaches, from all others.
HPCOMP_INLINE Thread find_thread_of_few(const WovenTerms &terms, const LaneSums &target) {
    Thread thread{};
    LaneSums first;
    for (int r = 0; r < kRegisters; ++r) first.part[r] = LaneInts{} + (1 << kHueBits);
    for (int l = 0; l < kLanes; ++l) thread.number[l] = -1;
    for (int k = 0; k < terms.n; ++k) {
        int32_t takes[kLanes];
        for (int r = 0; r < kRegisters; ++r) {
            const LaneInts own = terms.lanes(terms.hue, k, r), share = terms.lanes(terms.share, k, r);
            LaneInts reached = share;
            for (int j = 0; j < k; ++j)
                reached += (terms.lanes(terms.hue, j, r) <= own) & terms.lanes(terms.share, j, r);
            for (int j = k + 1; j < terms.n; ++j)
                reached += (terms.lanes(terms.hue, j, r) < own) & terms.lanes(terms.share, j, r);
            const LaneInts better = (reached > target.part[r]) & (own < first.part[r]) & (share > 0);
            first.part[r] = better ? own : first.part[r];
            std::memcpy(takes + r * kRegister, &better, sizeof better);
        }
        Thread::take(terms, k, takes, thread);
    }
    return thread;
}

// Of many: the largest number of a hue below which there is no more than the target, bit by bit. The terms of
// that number pass it. After the first bits only those terms are left to look at that are of the same.
HPCOMP_INLINE Thread find_thread_of_many(const WovenTerms &terms, const LaneSums &target) {
    LaneSums found{}, start{};
    const auto find = [&found, &target](int bit, const auto &shares_until) {
        LaneSums trial;
        for (int r = 0; r < kRegisters; ++r) trial.part[r] = found.part[r] + (1 << bit);
        const LaneSums below = shares_until(trial);
        for (int r = 0; r < kRegisters; ++r)
            found.part[r] = below.part[r] <= target.part[r] ? trial.part[r] : found.part[r];
    };
    constexpr int kFine = kHueBits - kCoarseBits;
    const auto of_all = [&terms](const LaneSums &trial) { return shares_below(terms, trial); };
    for (int bit = kHueBits - 1; bit >= kFine; --bit) find(bit, of_all);
    start = of_all(found);
    const LaneSums coarse = found;
    const int count = close_terms(terms, coarse, kFine);
    const auto of_close = [&](const LaneSums &trial) {
        LaneSums below = shares_below(terms, count, trial, coarse);
        for (int r = 0; r < kRegisters; ++r) below.part[r] += start.part[r];
        return below;
    };
    for (int bit = kFine - 1; bit >= 0; --bit) find(bit, of_close);
    LaneSums reached = of_close(found);
    // Of several with that number the first that passes it.
    Thread thread{};
    for (int l = 0; l < kLanes; ++l) thread.number[l] = -1;
    for (int c = 0; c < count; ++c) {
        const int k = terms.close[c];
        int32_t takes[kLanes];
        for (int r = 0; r < kRegisters; ++r) {
            LaneInts number;
            std::memcpy(&number, thread.number + r * kRegister, sizeof number);
            const LaneInts same = terms.lanes(terms.hue, k, r) == found.part[r];
            reached.part[r] += same & terms.lanes(terms.share, k, r);
            const LaneInts passes = same & (number < 0) & (reached.part[r] > target.part[r]);
            std::memcpy(takes + r * kRegister, &passes, sizeof passes);
        }
        Thread::take(terms, k, takes, thread);
    }
    return thread;
}

// The woven rule for one run of lanes: `kept` (count, kBlock) gets what it keeps of terms p (count, 2, kBlock)
// of `strengths` (count, kBlock), or of the lengths of p if that is null, from column `begin` on. `scratch`
// holds `weaving_floats`.
HPCOMP_INLINE void keep_thread(const Rules &rules, const float *p, const float *strengths, int count,
                               const float *phase, int begin, float *scratch, float *kept) {
    int *there = reinterpret_cast<int *>(scratch), own[kLanes];
    const int n = find_terms<kLanes>(p, count, begin, there, own);
    for (int k = 0; k < count; ++k)
        for (int l = 0; l < kLanes; ++l) kept[int64_t(k) * kBlock + begin + l] = 1;
    int mixed = 0;
    for (int l = 0; l < kLanes; ++l) mixed |= own[l] > 1;
    if (!mixed) return;

    WovenTerms terms(scratch + rounded_up(count), n);
    for (int k = 0; k < n; ++k) {
        ConstRow x = p + int64_t(there[k]) * 2 * kBlock + begin, y = x + kBlock;
        Row ux = terms.x + k * kLanes, uy = terms.y + k * kLanes, of = terms.length + k * kLanes;
        int32_t *hue = terms.hue + k * kLanes;
        for (int l = 0; l < kLanes; ++l) {
            const Scale scale = scale_of(x[l], y[l], 0, 0);
            ux[l] = x[l] * scale.down;
            uy[l] = y[l] * scale.down;
            of[l] = __builtin_sqrtf(ux[l] * ux[l] + uy[l] * uy[l]) * scale.up;
        }
        for (int l = 0; l < kLanes; ++l) hue[l] = hue_number(ux[l], uy[l]);
        std::memcpy(terms.m + k * kLanes, of, kLanes * sizeof(float));
    }
    if (strengths) take_strengths(strengths, there, n, begin, terms.m);

    float whole[kLanes] = {}, unit[kLanes];
    for (int k = 0; k < n; ++k)
        for (int l = 0; l < kLanes; ++l) whole[l] += terms.m[k * kLanes + l];
    // Of what is infinite or nothing there are no shares.
    for (int l = 0; l < kLanes; ++l) {
        const bool has_shares = (whole[l] > 0) & (whole[l] * 0 == 0);
        unit[l] = has_shares ? kShares / whole[l] : 0.0f;
    }
    float shares[kLanes] = {};
    for (int k = 0; k < n; ++k) {
        ConstRow of = terms.m + k * kLanes;
        int32_t *share = terms.share + k * kLanes;
        for (int l = 0; l < kLanes; ++l) {
            const float units = unit[l] > 0 ? of[l] * unit[l] : 0.0f;
            share[l] = int32_t(units);
            shares[l] += float(share[l]);
        }
    }
    int32_t passed[kLanes];
    for (int l = 0; l < kLanes; ++l) passed[l] = int32_t(phase[begin + l] * shares[l]);
    LaneSums target;
    std::memcpy(&target, passed, sizeof target);
    const Thread thread = n <= kFewTerms ? find_thread_of_few(terms, target) : find_thread_of_many(terms, target);

    // What is of its hue stands for all strength.
    float amount[kLanes] = {}, strength[kLanes] = {}, others[kLanes] = {};
    for (int k = 0; k < n; ++k) {
        ConstRow of = terms.m + k * kLanes, lengths = terms.length + k * kLanes;
        ConstRow x = terms.x + k * kLanes, y = terms.y + k * kLanes;
        for (int l = 0; l < kLanes; ++l) {
            const float dot = thread.x[l] * x[l] + thread.y[l] * y[l];
            const float across = magnitude(thread.x[l] * y[l] - thread.y[l] * x[l]);
            // But for rounding; what has no hue is not of another.
            const bool its = across <= rules.rounding_angle * dot;
            amount[l] += its ? lengths[l] : 0.0f;
            strength[l] += its ? of[l] : 0.0f;
            others[l] += its ? 0.0f : lengths[l];
        }
    }
    float factor[kLanes], alone[kLanes];
    for (int l = 0; l < kLanes; ++l) {
        factor[l] = amount[l] * (whole[l] / strength[l]) / thread.length[l];
        const bool one = (others[l] == 0) | (thread.number[l] < 0) | (whole[l] * 0 != 0);
        alone[l] = one ? 1.0f : 0.0f;
    }
    for (int k = 0; k < n; ++k) {
        Row share = kept + int64_t(there[k]) * kBlock + begin;
        ConstRow lengths = terms.length + k * kLanes;
        for (int l = 0; l < kLanes; ++l) {
            const float of_others = lengths[l] > 0 ? 0.0f : 1.0f;
            const float woven = thread.number[l] == k ? factor[l] : of_others;
            share[l] = alone[l] != 0 ? 1.0f : woven;
        }
    }
}

// Reduces weighted p (count, 2, kBlock) to the place of the first, and tells in `kept` (count, kBlock) what is
// kept of each term.
HPCOMP_INLINE void weave_terms(const Rules &rules, float *p, const float *strengths, int count, int n,
                               const float *phase, float *scratch, float *kept) {
    for (int begin = 0; begin < n; begin += kLanes) {
        keep_thread(rules, p, strengths, count, phase, begin, scratch, kept);
        sum_kept(p, kept, count, begin);
    }
}

}  // namespace
}  // namespace hpcomp
