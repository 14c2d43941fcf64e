#include "levels.h"

#include <stdexcept>

namespace hpcomp {

#define HPCOMP_LEVEL_EXISTS(name)        \
    extern const Engine engine_##name;   \
    extern const Packing packing_##name; \
    extern const Measuring measuring_##name;

HPCOMP_LEVEL_EXISTS(baseline)
#ifdef HPCOMP_HAS_V3
HPCOMP_LEVEL_EXISTS(v3)
#endif
#ifdef HPCOMP_HAS_V4
HPCOMP_LEVEL_EXISTS(v4)
#endif

static std::vector<Level> found_levels() {
    std::vector<Level> found = {{"baseline", &engine_baseline, &packing_baseline, &measuring_baseline}};
#ifdef HPCOMP_HAS_V3
    __builtin_cpu_init();
    const bool v3 = __builtin_cpu_supports("avx2") && __builtin_cpu_supports("bmi2") &&
                    __builtin_cpu_supports("fma");
    if (v3) found.push_back({"v3", &engine_v3, &packing_v3, &measuring_v3});
#ifdef HPCOMP_HAS_V4
    if (v3 && __builtin_cpu_supports("avx512f") && __builtin_cpu_supports("avx512bw") &&
        __builtin_cpu_supports("avx512cd") && __builtin_cpu_supports("avx512dq") &&
        __builtin_cpu_supports("avx512vl"))
        found.push_back({"v4", &engine_v4, &packing_v4, &measuring_v4});
#endif
#endif
    return found;
}

const std::vector<Level> &levels() {
    static const std::vector<Level> found = found_levels();
    return found;
}

const Level &level_of(const std::string &name) {
    if (name.empty()) return levels().back();
    for (const Level &level : levels())
        if (name == level.name) return level;
    throw std::invalid_argument("this processor does not run that level");
}

}  // namespace hpcomp
