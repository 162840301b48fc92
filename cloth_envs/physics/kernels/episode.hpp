#pragma once
#include <nanobind/nanobind.h>

namespace minicloth {

void bind_episode(nanobind::module_& m);

}  // namespace minicloth
