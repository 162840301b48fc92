// The Python module _minicloth_kernels.
#define MINICLOTH_IMPORTS_NUMPY
#include "module.hpp"

#include "base/arrays.hpp"
#include "base/dispatch.hpp"

NB_MODULE(_minicloth_kernels, m) {
  using namespace minicloth;
  if (_import_array() < 0) nanobind::raise_python_error();
  nanobind::set_leak_warnings(false);  // at the end of a process whose threads still run, objects are left
  m.doc() = "Compiled loops of MiniCloth.";
  bind_sheet(m);
  bind_explicit(m);
  bind_admm(m);
  bind_implicit(m);
  bind_particles(m);
  bind_count(m);
  bind_resample(m);
  bind_correct(m);
  bind_patch(m);
  bind_detail(m);
  bind_fine(m);
  bind_state(m);
  bind_measures(m);
  bind_controls(m);
  bind_choose(m);
  bind_card(m);
  bind_drawn(m);
  m.def("instruction_set", [] { return kSets[kSet]; }, "The instruction set that the kernels run on this processor.");
}
