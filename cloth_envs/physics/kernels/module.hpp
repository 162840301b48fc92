// What each room adds to the Python module.
#pragma once
#include <nanobind/nanobind.h>

namespace minicloth {

void bind_sheet(nanobind::module_& m);
void bind_explicit(nanobind::module_& m);
void bind_admm(nanobind::module_& m);
void bind_implicit(nanobind::module_& m);
void bind_particles(nanobind::module_& m);
void bind_count(nanobind::module_& m);
void bind_resample(nanobind::module_& m);
void bind_correct(nanobind::module_& m);
void bind_patch(nanobind::module_& m);
void bind_detail(nanobind::module_& m);
void bind_fine(nanobind::module_& m);
void bind_state(nanobind::module_& m);
void bind_measures(nanobind::module_& m);
void bind_controls(nanobind::module_& m);
void bind_choose(nanobind::module_& m);
void bind_card(nanobind::module_& m);
void bind_drawn(nanobind::module_& m);

}  // namespace minicloth
