// The order `simultaneous` for one pixel of many terms, without a table of all their pairs.

#pragma once

#include "block.h"

namespace hpcomp {

// What is kept of the `n` terms p (n, 2), each of which has chroma: factors `kept` (n), which stay as they are
// where a term is not finite. `strengths` (n): what competes, null where it is the length of p. `scratch`
// holds `sorting_doubles`. The order of the terms changes no bit.
void keep_of_many(const Rules &rules, const double *p, const double *strengths, int n, double *scratch,
                  double *kept);

}  // namespace hpcomp
