// What both bindings check arrays with.

#pragma once

#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>

#include <cstdint>

namespace hpcomp {

inline void check_aligned(const void *data, int64_t bytes) {
    if (reinterpret_cast<uintptr_t>(data) % uintptr_t(bytes) != 0)
        throw nanobind::value_error("an array must be aligned");
}

inline bool is_half(nanobind::dlpack::dtype type) {
    return type.code == uint8_t(nanobind::dlpack::dtype_code::Float) && type.bits == 16 &&
           type.lanes == 1;
}

// Adds the functions on packed bytes, as a module within it: the engine needs none of them.
void bind_packing(nanobind::module_ &kernel);

}  // namespace hpcomp
