// The net of particles for Python.
#include <nanobind/stl/vector.h>

#include "arrays.hpp"
#include "particles.hpp"

namespace nb = nanobind;

namespace minicloth {
namespace {

template <class T>
void advance_net(const Net<T>& net, In<T, 4> x, In<T, 4> v, Out<T, 4> x_out, Out<T, 4> v_out, In<double, 3> handle_x,
                 In<double, 3> handle_v, In<T, 4> body_x, In<T, 4> body_v, In<double, 4> body_x_end,
                 In<double, 4> body_v_end, In<double, 1> pressure, int threads) {
  const std::size_t batch = x.shape(0), rows = net.step.rows, cols = net.step.cols, n = 3 * rows * cols;
  const std::size_t handles = net.handles.size(), balls = net.radii.size();
  const std::initializer_list<std::size_t> cloth = {batch, 3, rows, cols}, held = {batch, handles, 3},
                                           axes = {batch, balls, 2, 3};
  need(shaped(x, cloth) && shaped(v, cloth) && shaped(x_out, cloth) && shaped(v_out, cloth),
       "positions and velocities must be (B, 3, H, W)");
  need(shaped(handle_x, held) && shaped(handle_v, held), "handles must be (B, N, 3)");
  need(shaped(body_x, axes) && shaped(body_v, axes) && shaped(body_x_end, axes) && shaped(body_v_end, axes),
       "colliders must be (B, C, 2, 3)");
  need(shaped(pressure, {batch}), "pressure must be (B,)");
  need(threads >= 1, "threads must be at least 1");
  std::vector<NetFrame<T>> frames(batch);
  for (std::size_t b = 0; b < batch; ++b) {
    const std::size_t h = b * handles * 3, c = b * balls * 6;
    frames[b] = {x.data() + b * n,      v.data() + b * n,      x_out.data() + b * n, v_out.data() + b * n,
                 handle_x.data() + h,   handle_v.data() + h,   body_x.data() + c,    body_v.data() + c,
                 body_x_end.data() + c, body_v_end.data() + c, pressure.data()[b]};
  }
  nb::gil_scoped_release release;
  advance(net, frames, threads);
}

template <class T>
void make_net(Net<T>* self, int rows, int cols, In<int, 2> neighbours, In<double, 2> coefficients, In<double, 1> bias,
              double eps, double node_mass, double decay, double keep, double frame_dt, int substeps,
              std::vector<int> handles, std::vector<double> radii) {
  const std::size_t count = neighbours.shape(0);
  need(count <= kMostNeighbours && neighbours.shape(1) == 2, "neighbours must be (N, 2) with N of at most 16");
  need(shaped(coefficients, {count, 3}) && shaped(bias, {3}), "coefficients must be (N, 3), bias (3,)");
  need(rows >= 1 && cols >= 2 && substeps >= 1, "rows, cols and substeps must be positive");
  for (int h : handles) need(h >= 0 && h < rows * cols, "a handle is not a vertex of the grid");
  const double dt = frame_dt / substeps;
  NetStep<T> step = {};
  step.rows = rows, step.cols = cols, step.count = int(count);
  for (std::size_t i = 0; i < count; ++i) {
    const double* k = coefficients.data() + 3 * i;
    step.links[i] = {neighbours.data()[2 * i], neighbours.data()[2 * i + 1], T(k[0]), T(k[1]), T(k[2])};
  }
  for (int k = 0; k < 3; ++k) step.bias[k] = T(bias.data()[k]);
  step.eps = T(eps), step.kick = T(dt / node_mass), step.decay = T(decay), step.dt = T(dt);
  new (self) Net<T>{step, frame_dt, substeps, keep, std::move(handles), std::move(radii)};
}

template <class T>
void bind(nb::module_& m, const char* name) {
  nb::class_<Net<T>>(m, name)
      .def("__init__", &make_net<T>, nb::kw_only(), nb::arg("rows"), nb::arg("cols"), nb::arg("neighbours"),
           nb::arg("coefficients"), nb::arg("bias"), nb::arg("eps"), nb::arg("node_mass"), nb::arg("decay"),
           nb::arg("keep"), nb::arg("frame_dt"), nb::arg("substeps"), nb::arg("handles"), nb::arg("radii"))
      .def("advance", &advance_net<T>);
}

}  // namespace

void bind_particles(nb::module_& m) {
  bind<float>(m, "Particles32");
  bind<double>(m, "Particles64");
}

}  // namespace minicloth
