#pragma once
#include <nanobind/nanobind.h>

namespace minicloth {

void bind_resample(nanobind::module_& m);

}  // namespace minicloth
