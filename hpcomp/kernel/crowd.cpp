// Terms are sorted by hue. Hues back each other only up to the end of the shoulder, so what backs a term,
// and the rivals that share backers with it, lie in windows around it; of all others only the strongest
// counts. This file is compiled once: sorting has no use for wider registers.

#include "crowd.h"

#include <algorithm>
#include <limits>
#include <tuple>

#include "addition.h"

namespace hpcomp {
namespace {

constexpr double kTurn = 2 * kPi;
// Above what rounding changes in an angle: a window may hold a term too much, whose shoulder is 0.
constexpr double kAngleMargin = 1e-12;

struct Term {
    double hue, m;  // radians in (-pi, pi]; |p|
    float x, y;
};

struct Window {
    int begin, end;
};

// Of `n` terms. What is (3 n) goes around the circle three times, with the terms themselves from n to
// 2 n, so that no window around them wraps.
struct Crowd {
    int n;
    double equal, end;       // angles up to which a shoulder is 1, and from which it is 0
    Term *terms;             // (n), by hue
    double *hue, *m;         // (3 n)
    double *m_before;        // (3 n + 1): the sum of all m before
    Window *backers;         // (n): all whose shoulder with the term is not 0
    double *support, *hold;  // (n): what backs it, and the most that its own hue can hold
    double *strength;        // (3 n): as a rival of hues without a common backer
    double *rest;            // (2 n + 1): more scratch

    Crowd(const Rules &rules, int n, double *scratch) : n(n) {
        const auto take = [&scratch](int64_t doubles) { return (scratch += doubles) - doubles; };
        const int64_t turns = 3 * int64_t(n);
        equal = double(rules.tolerance);
        end = rules.inverse_tolerance > 0 ? smaller(2 * equal, kPi) : equal;
        terms = reinterpret_cast<Term *>(take(turns));
        hue = take(turns), m = take(turns), strength = take(turns), m_before = take(turns + 1);
        backers = reinterpret_cast<Window *>(take(n));
        support = take(n), hold = take(n), rest = scratch;
    }

    void repeat(double *values, double turn) const {
        for (int k = 0; k < n; ++k) {
            values[k] = values[n + k] - turn;
            values[2 * n + k] = values[n + k] + turn;
        }
    }
};

// The windows of the hues within `reach` of one hue after the other, which hold no term twice.
struct Sliding {
    const Crowd &crowd;
    double reach;
    int begin = 0, end = 0;

    Window to(double hue) {
        while (crowd.hue[begin] < hue - reach - kAngleMargin) ++begin;
        while (end < 3 * crowd.n && crowd.hue[end] <= hue + reach + kAngleMargin) ++end;
        return {begin, std::min(end, begin + crowd.n)};
    }
};

// As in `addition.h`, of an angle.
double shoulder(const Rules &rules, double angle) {
    if (rules.inverse_tolerance == 0) return angle <= double(rules.tolerance) ? 1 : 0;
    const double t = smaller(larger(angle * double(rules.inverse_tolerance) - 1, 0.0), 1.0);
    return 1 - t * t * (3 - 2 * t);
}

// Terms sorted by hue, then by all else; false where one is NaN or infinite.
bool sort_terms(const float *p, const int *there, const Crowd &crowd) {
    bool finite = true;
    for (int k = 0; k < crowd.n; ++k) {
        const float *of = p + int64_t(there[k]) * 2 * kBlock;
        const double x = double(of[0]), y = double(of[kBlock]), angle = angle_of(magnitude(y), x);
        crowd.terms[k] = {y < 0 ? -angle : angle, __builtin_sqrt(x * x + y * y), of[0], of[kBlock]};
        finite &= crowd.terms[k].m - crowd.terms[k].m == 0;
    }
    if (!finite) return false;
    std::sort(crowd.terms, crowd.terms + crowd.n, [](const Term &a, const Term &b) {
        return std::tie(a.hue, a.m, a.x, a.y) < std::tie(b.hue, b.m, b.x, b.y);
    });
    return true;
}

void put_around_circle(const Crowd &crowd) {
    for (int k = 0; k < crowd.n; ++k) {
        crowd.hue[crowd.n + k] = crowd.terms[k].hue;
        crowd.m[crowd.n + k] = crowd.terms[k].m;
    }
    crowd.repeat(crowd.hue, kTurn);
    crowd.repeat(crowd.m, 0);
    crowd.m_before[0] = 0;
    for (int k = 0; k < 3 * crowd.n; ++k) crowd.m_before[k + 1] = crowd.m_before[k] + crowd.m[k];
}

void find_supports(const Rules &rules, const Crowd &crowd) {
    Sliding equal{crowd, crowd.equal}, backing{crowd, crowd.end};
    for (int i = 0; i < crowd.n; ++i) {
        const double hue = crowd.terms[i].hue;
        const Window same = equal.to(hue), all = crowd.backers[i] = backing.to(hue);
        double sum = crowd.m_before[same.end] - crowd.m_before[same.begin];
        const auto back = [&](int k) { sum += shoulder(rules, magnitude(hue - crowd.hue[k])) * crowd.m[k]; };
        for (int k = all.begin; k < same.begin; ++k) back(k);
        for (int k = same.end; k < all.end; ++k) back(k);
        crowd.support[i] = sum;
    }
}

// hold[i]: the sum of min(m_i, m_k) over all terms k.
void find_holds(const Crowd &crowd) {
    const int n = crowd.n;
    double *sorted = crowd.rest, *before = sorted + n;
    for (int k = 0; k < n; ++k) sorted[k] = crowd.terms[k].m;
    std::sort(sorted, sorted + n);
    before[0] = 0;
    for (int k = 0; k < n; ++k) before[k + 1] = before[k] + sorted[k];
    for (int i = 0; i < n; ++i) {
        const double m = crowd.terms[i].m;
        const int64_t weaker = std::lower_bound(sorted, sorted + n, m) - sorted;
        crowd.hold[i] = before[weaker] + double(n - weaker) * m;
    }
}

// What share of a term a rival cancels that has `strength` against `support`.
double cancelled(const Rules &rules, double strength, double support) {
    const double q = support > 0 ? smaller(strength / support, 1.0) : 0.0;
    return rules.gray_power > 0 ? q * double(bias(rules, float(q))) : q;
}

// A term's backers: radians from it to them, and how much each backs it. Zeros follow, for a register.
struct Backing {
    float *angle, *m;
    Window of;

    void fill(const Rules &rules, const Crowd &crowd, int i) {
        of = crowd.backers[i];
        const int n = of.end - of.begin;
        for (int k = 0; k < n; ++k) {
            const double to = crowd.hue[of.begin + k] - crowd.terms[i].hue;
            angle[k] = float(to);
            m[k] = float(shoulder(rules, magnitude(to)) * crowd.m[of.begin + k]);
        }
        for (int k = n; k < n + kRegister; ++k) angle[k] = m[k] = 0;
    }
};

// What backs both a term and a hue at an angle `other` from it: the sum over some of its backers.
template <bool kSmooth>
float backing_both(const Rules &rules, const float *angle, const float *m, int n, float other) {
    Lanes sum = {};
    for (int k = 0; k < n; k += kRegister) {
        const Lanes difference = lanes_of(angle + k) - other;
        const Lanes one_way = difference < 0.0f ? -difference : difference;
        const Lanes between = smaller(one_way, float(kTurn) - one_way);
        Lanes e;
        if (kSmooth) {
            Lanes t = between * rules.inverse_tolerance - 1.0f;
            t = smaller(t < 0.0f ? Lanes{} : t, Lanes{} + 1.0f);
            e = 1.0f - t * t * (3.0f - 2.0f * t);
        } else {
            e = between <= rules.tolerance ? Lanes{} + 1.0f : Lanes{};
        }
        sum += lanes_of(m + k) * e;
    }
    float total = 0;
    for (int l = 0; l < kRegister; ++l) total += sum[l];
    return total;
}

// What rival `j` (of 3 n) cancels of term `i`, which it may share backers with.
double cancelled_by(const Rules &rules, const Crowd &crowd, const Backing &backing, int i, int j) {
    const double to = crowd.hue[j] - crowd.terms[i].hue;
    const int rival = j % crowd.n, turns = j - rival - crowd.n;
    int begin = backing.of.begin, end = backing.of.end;
    if (crowd.end <= kPi / 2) {  // or else their windows may meet on either side of the circle
        begin = std::max(begin, crowd.backers[rival].begin + turns);
        end = std::min(end, crowd.backers[rival].end + turns);
    }
    double both = 0;
    if (begin < end) {
        const auto sum = rules.inverse_tolerance > 0 ? backing_both<true> : backing_both<false>;
        const int first = begin - backing.of.begin;
        both = double(sum(rules, backing.angle + first, backing.m + first, end - begin, float(to)));
    }
    const double strength = smaller(larger(crowd.support[rival] - both, 0.0), crowd.hold[rival]);
    return (1 - shoulder(rules, magnitude(to))) * cancelled(rules, strength, crowd.support[i] - both);
}

}  // namespace

void sum_of_crowd(const Rules &rules, const float *p, const int *there, int n, float *scratch,
                  float *sum0, float *sum1) {
    const Crowd crowd(rules, n, reinterpret_cast<double *>(scratch));
    if (!sort_terms(p, there, crowd)) {
        *sum0 = *sum1 = std::numeric_limits<float>::quiet_NaN();
        return;
    }
    put_around_circle(crowd);
    find_supports(rules, crowd);
    find_holds(crowd);
    for (int k = 0; k < n; ++k) crowd.strength[n + k] = smaller(crowd.support[k], crowd.hold[k]);
    crowd.repeat(crowd.strength, 0);

    Sliding equal{crowd, crowd.equal}, sharing{crowd, smaller(2 * crowd.end, kPi)};
    float *row = reinterpret_cast<float *>(crowd.rest);
    Backing backing{row, row + n + kRegister, {}};
    double total0 = 0, total1 = 0;
    for (int i = 0; i < n; ++i) {
        const Term &term = crowd.terms[i];
        const Window same = equal.to(term.hue), near = sharing.to(term.hue);
        double strongest = 0;
        for (int j = near.end; j < near.begin + n; ++j) strongest = larger(strongest, crowd.strength[j]);
        double part = cancelled(rules, strongest, crowd.support[i]);
        if (near.end - near.begin > same.end - same.begin) backing.fill(rules, crowd, i);
        for (int j = near.begin; j < same.begin; ++j)
            part = larger(part, cancelled_by(rules, crowd, backing, i, j));
        for (int j = same.end; j < near.end; ++j)
            part = larger(part, cancelled_by(rules, crowd, backing, i, j));
        total0 += (1 - part) * double(term.x);
        total1 += (1 - part) * double(term.y);
    }
    *sum0 = float(total0);
    *sum1 = float(total1);
}

}  // namespace hpcomp
