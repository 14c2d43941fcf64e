// Sums of values in whole units of 2^-24, so that they do not depend on strips, threads or processors.

#pragma once

#include "floats.h"

namespace hpcomp {
namespace {

constexpr float kLargestAddend = 4096;
// Units of values up to this one fit 32 bits, and so do the sums of a run of them.
constexpr float kSmallAddend = 1;
constexpr int kSmallRun = 64;

HPCOMP_INLINE int32_t small_units_of(float value) { return int32_t(__builtin_rintf(value * 0x1p24f)); }

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

// Whether no value of some planes is larger than `kSmallAddend`, or NaN.
template <class... Planes>
HPCOMP_INLINE bool all_small(int n, const Planes *...planes) {
    uint32_t beyond = 0;
    for (int i = 0; i < n; ++i)
        beyond |= (... | (bits_of(kSmallAddend) - (bits_of(planes[i]) & 0x7fffffffu)));
    return (beyond >> 31) == 0;
}

// The sum of values from 0 up; `small`: none is larger than `kSmallAddend`.
int64_t sum_of(const float *values, int n, bool small) {
    int64_t total = 0;
    if (small) {
        for (int begin = 0; begin < n; begin += kSmallRun) {
            const int end = n - begin < kSmallRun ? n : begin + kSmallRun;
            int32_t sum = 0;
            for (int i = begin; i < end; ++i) sum += small_units_of(values[i]);
            total += sum;
        }
        return total;
    }
    for (int i = 0; i < n; ++i) total += units_of(smaller(values[i], kLargestAddend));
    return total;
}

}  // namespace
}  // namespace hpcomp
