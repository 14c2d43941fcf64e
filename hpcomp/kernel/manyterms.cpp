// Terms are sorted by hue. Hues back each other only up to the end of the shoulder, so what backs a term,
// and the rivals that share backers with it, lie in windows around it; of all others only the strongest
// counts. This file is compiled once: sorting has no use for wider registers.

#include "manyterms.h"

#include <algorithm>
#include <tuple>

#include "addition.h"

namespace hpcomp {
namespace {

constexpr double kTurn = 2 * kPi;
// Above what rounding changes in an angle: a window may hold a term too much, whose shoulder is 0.
constexpr double kAngleMargin = 1e-12;

struct Term {
    double hue, m;  // radians in (-pi, pi]; |p|, or another strength
    int64_t number;
};

struct Window {
    int begin, end;
};

// Of `n` terms. What is (3 n) goes around the circle three times, with the terms themselves from n to
// 2 n, so that no window around them wraps.
struct HueCircle {
    int n;
    double equal, end;       // angles up to which a shoulder is 1, and from which it is 0
    Term *terms;             // (n), by hue
    double *hue, *m;         // (3 n)
    double *m_before;        // (3 n + 1): the sum of all m before
    Window *backers;         // (n): all whose shoulder with the term is not 0
    double *support, *hold;  // (n): what backs it, and the most that its own hue can hold
    double *strength;        // (3 n): as a rival of hues without a common backer
    double *rest;            // (5 n + 4): more scratch

    HueCircle(const Rules &rules, int n, double *scratch) : n(n) {
        const auto take = [&scratch](int64_t doubles) { return (scratch += doubles) - doubles; };
        const int64_t turns = 3 * int64_t(n);
        static_assert(sizeof(Term) == 3 * sizeof(double) && sizeof(Window) == sizeof(double));
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
    const HueCircle &circle;
    double reach;
    int begin = 0, end = 0;

    Window to(double hue) {
        while (circle.hue[begin] < hue - reach - kAngleMargin) ++begin;
        while (end < 3 * circle.n && circle.hue[end] <= hue + reach + kAngleMargin) ++end;
        return {begin, std::min(end, begin + circle.n)};
    }
};

// As in `addition.h`, of an angle.
double shoulder(const Rules &rules, double angle) {
    if (rules.inverse_tolerance == 0) return angle <= double(rules.tolerance) ? 1 : 0;
    const double t = smaller(larger(angle * double(rules.inverse_tolerance) - 1, 0.0), 1.0);
    return 1 - t * t * (3 - 2 * t);
}

// Terms sorted by hue, then by strength; false where one is NaN or infinite.
bool sort_terms(const double *p, const double *strengths, const HueCircle &circle) {
    bool finite = true, strong = false;
    for (int k = 0; strengths && k < circle.n; ++k) strong |= strengths[k] != 0;
    for (int k = 0; k < circle.n; ++k) {
        const double x = p[2 * int64_t(k)], y = p[2 * int64_t(k) + 1], angle = angle_of(magnitude(y), x);
        const double length = __builtin_sqrt(x * x + y * y);
        circle.terms[k] = {y < 0 ? -angle : angle, strong ? strengths[k] : length, k};
        finite &= circle.terms[k].m - circle.terms[k].m == 0 && length - length == 0;
    }
    if (!finite) return false;
    std::sort(circle.terms, circle.terms + circle.n, [](const Term &a, const Term &b) {
        return std::tie(a.hue, a.m) < std::tie(b.hue, b.m);
    });
    return true;
}

void put_around_circle(const HueCircle &circle) {
    for (int k = 0; k < circle.n; ++k) {
        circle.hue[circle.n + k] = circle.terms[k].hue;
        circle.m[circle.n + k] = circle.terms[k].m;
    }
    circle.repeat(circle.hue, kTurn);
    circle.repeat(circle.m, 0);
    circle.m_before[0] = 0;
    for (int k = 0; k < 3 * circle.n; ++k) circle.m_before[k + 1] = circle.m_before[k] + circle.m[k];
}

void find_supports(const Rules &rules, const HueCircle &circle) {
    Sliding equal{circle, circle.equal}, backing{circle, circle.end};
    for (int i = 0; i < circle.n; ++i) {
        const double hue = circle.terms[i].hue;
        const Window same = equal.to(hue), all = circle.backers[i] = backing.to(hue);
        double sum = circle.m_before[same.end] - circle.m_before[same.begin];
        const auto back = [&](int k) { sum += shoulder(rules, magnitude(hue - circle.hue[k])) * circle.m[k]; };
        for (int k = all.begin; k < same.begin; ++k) back(k);
        for (int k = same.end; k < all.end; ++k) back(k);
        circle.support[i] = sum;
    }
}

// hold[i]: the sum of min(m_i, m_k) over all terms k.
void find_holds(const HueCircle &circle) {
    const int n = circle.n;
    double *sorted = circle.rest, *before = sorted + n;
    for (int k = 0; k < n; ++k) sorted[k] = circle.terms[k].m;
    std::sort(sorted, sorted + n);
    before[0] = 0;
    for (int k = 0; k < n; ++k) before[k + 1] = before[k] + sorted[k];
    for (int i = 0; i < n; ++i) {
        const double m = circle.terms[i].m;
        const int64_t weaker = std::lower_bound(sorted, sorted + n, m) - sorted;
        circle.hold[i] = before[weaker] + double(n - weaker) * m;
    }
}

// What share of a term a rival cancels that has `strength` against `support`.
double cancelled(const Rules &rules, double strength, double support) {
    const double unbacked = strength > 0 ? 1.0 : 0.0;
    const double q = support > 0 ? smaller(strength / support, 1.0) : unbacked;
    return rules.gray_power > 0 ? q * double(bias(rules, float(q))) : q;
}

// What backs a term, by angle from it in tolerances: sums of how much, times the powers 0 to 3 of that
// angle. A shoulder is a cubic, so these give what else it backs without a look at every backer.
struct Backing {
    int n;
    double *angle;    // (n)
    double *sums[4];  // (n + 1): of those before

    Backing(const HueCircle &circle) : n(0), angle(circle.rest) {
        for (int power = 0; power < 4; ++power)
            sums[power] = circle.rest + circle.n + power * int64_t(circle.n + 1);
    }

    void fill(const Rules &rules, const HueCircle &circle, int i) {
        const Window of = circle.backers[i];
        n = of.end - of.begin;
        for (int power = 0; power < 4; ++power) sums[power][0] = 0;
        for (int k = 0; k < n; ++k) {
            const double radians = circle.hue[of.begin + k] - circle.terms[i].hue;
            angle[k] = radians / circle.equal;
            double share = shoulder(rules, magnitude(radians)) * circle.m[of.begin + k];
            for (int power = 0; power < 4; ++power) {
                sums[power][k + 1] = sums[power][k] + share;
                share *= angle[k];
            }
        }
    }

    double sum(int power, int begin, int end) const { return sums[power][end] - sums[power][begin]; }
};

// Slides over other hues: how much backs both the term and such a one.
struct Common {
    const Backing &backing;
    bool smooth;
    int edges[4] = {};  // where the other's shoulder begins, is 1, begins to fall, and ends

    double to(double other) {
        constexpr double offsets[4] = {-2, -1, 1, 2};
        for (int e = 0; e < 4; ++e)
            while (edges[e] < backing.n && backing.angle[edges[e]] < other + offsets[e]) ++edges[e];
        double both = backing.sum(0, edges[1], edges[2]);
        if (smooth) both += side(other - 1, -1, edges[0], edges[1]) + side(other + 1, 1, edges[2], edges[3]);
        return both;
    }

    // Of 1 - t * t * (3 - 2 * t) with t from 0 to 1 on the way from `foot` to that side.
    double side(double foot, double sign, int begin, int end) const {
        if (begin == end) return 0;
        const double s = sign * foot;
        return (1 - s * s * (3 + 2 * s)) * backing.sum(0, begin, end) +
               sign * 6 * s * (1 + s) * backing.sum(1, begin, end) -
               (3 + 6 * s) * backing.sum(2, begin, end) + sign * 2 * backing.sum(3, begin, end);
    }
};

// What its rivals near by cancel of a term at most; `same` are those of its own hue.
double cancelled_near(const Rules &rules, const HueCircle &circle, const Backing &backing, int i, Window near,
                      Window same) {
    const bool smooth = rules.inverse_tolerance > 0;
    const double turn = kTurn / circle.equal;
    // Far shoulders may meet on the other side of the circle, too.
    const bool both_ways = circle.end > kPi / 2;
    Common common{backing, smooth}, from_below{backing, smooth}, from_above{backing, smooth};
    double part = 0;
    for (int j = near.begin; j < near.end; ++j) {
        if (j == same.begin) j = same.end;
        if (j >= near.end) break;
        const double radians = circle.hue[j] - circle.terms[i].hue, other = radians / circle.equal;
        double both = common.to(other);
        if (both_ways) both += from_below.to(other - turn) + from_above.to(other + turn);
        const int rival = j % circle.n;
        const double strength = smaller(larger(circle.support[rival] - both, 0.0), circle.hold[rival]);
        const double unequal = 1 - shoulder(rules, magnitude(radians));
        part = larger(part, unequal * cancelled(rules, strength, circle.support[i] - both));
    }
    return part;
}

}  // namespace

void keep_of_many(const Rules &rules, const double *p, const double *strengths, int n, double *scratch,
                  double *kept) {
    const HueCircle circle(rules, n, scratch);
    if (!sort_terms(p, strengths, circle)) return;
    put_around_circle(circle);
    find_supports(rules, circle);
    find_holds(circle);
    for (int k = 0; k < n; ++k) circle.strength[n + k] = smaller(circle.support[k], circle.hold[k]);
    circle.repeat(circle.strength, 0);

    Sliding equal{circle, circle.equal}, sharing{circle, smaller(2 * circle.end, kPi)};
    Backing backing(circle);
    for (int i = 0; i < n; ++i) {
        const Term &term = circle.terms[i];
        const Window same = equal.to(term.hue), near = sharing.to(term.hue);
        double strongest = 0;
        for (int j = near.end; j < near.begin + n; ++j) strongest = larger(strongest, circle.strength[j]);
        double part = cancelled(rules, strongest, circle.support[i]);
        if (near.end - near.begin > same.end - same.begin) {
            backing.fill(rules, circle, i);
            part = larger(part, cancelled_near(rules, circle, backing, i, near, same));
        }
        kept[term.number] = 1 - part;
    }
}

}  // namespace hpcomp
