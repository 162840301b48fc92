// The net of particles for Python.
#include "../sheet/bind.hpp"

#include "../module.hpp"
#include "core.hpp"

namespace nb = nanobind;

namespace minicloth {
namespace {

template <class T>
void advance_net(const Net<T>& net, const PythonState& old, const PythonState& now, const PythonControls& controls,
                 int threads) {
  const Frames<T> frames(net.sheet, old, now, controls);
  need(threads >= 1, "threads must be at least 1");
  nb::gil_scoped_release release;
  advance(net, frames(), threads);
}

template <class T>
void make_net(Net<T>* self, const Sheet& sheet, In<int, 2> neighbours, In<double, 2> coefficients, In<double, 1> bias,
              double eps, double node_mass, double decay, double keep, int substeps, bool in_place) {
  const std::size_t count = neighbours.shape(0);
  need(count <= kMostNeighbours && neighbours.shape(1) == 2, "neighbours must be (N, 2) with N of at most 16");
  need(shaped(coefficients, {count, 3}) && shaped(bias, {3}), "coefficients must be (N, 3), bias (3,)");
  need(substeps >= 1, "substeps must be positive");
  const double dt = sheet.frame_dt / substeps;
  NetStep<T> step = {};
  step.waves = {sheet.rows, sheet.cols}, step.count = int(count);
  for (std::size_t i = 0; i < count; ++i) {
    const int down = neighbours.data()[2 * i], right = neighbours.data()[2 * i + 1];
    need(Waves::reached(down, right), "a neighbour must be one of the 12 in reach of the waves");
    const double* k = coefficients.data() + 3 * i;
    step.links[i] = {down, right, step.waves.shift(down, right), T(k[0]), T(k[1]), T(k[2])};
  }
  for (int k = 0; k < 3; ++k) step.weight[k] = T(dt / node_mass * bias.data()[k]);
  step.eps = T(eps), step.kick = T(dt / node_mass), step.decay = T(decay), step.dt = T(dt);
  new (self) Net<T>{sheet, step, substeps, keep, in_place};
}

template <class T>
void bind_net(nb::module_& m, const char* name) {
  nb::class_<Net<T>>(m, name)
      .def("__init__", &make_net<T>, nb::arg("sheet"), nb::kw_only(), nb::arg("neighbours"), nb::arg("coefficients"),
           nb::arg("bias"), nb::arg("eps"), nb::arg("node_mass"), nb::arg("decay"), nb::arg("keep"),
           nb::arg("substeps"), nb::arg("in_place"))
      .def("advance", &advance_net<T>, nb::arg("old"), nb::arg("new"), nb::arg("controls"), nb::arg("threads"),
           "A frame from old to the positions and velocities of new.");
}

}  // namespace

void bind_particles(nb::module_& m) {
  bind_net<float>(m, "Particles32");
  bind_net<double>(m, "Particles64");
}

}  // namespace minicloth
