// P-ADMM for Python.
#include <nanobind/stl/shared_ptr.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/vector.h>

#include "admm.hpp"
#include "arrays.hpp"

namespace nb = nanobind;

namespace minicloth {
namespace {

template <class T>
void advance(const Admm<T>& solver, const typename Admm<T>::Systems& systems, In<T, 4> x, In<T, 4> v, Out<T, 4> x_out,
             Out<T, 4> v_out, In<double, 2> sheets, In<double, 3> handle_x, In<double, 3> handle_v, In<T, 4> body_x,
             In<T, 4> body_v, In<double, 4> body_x_end, In<double, 4> body_v_end, In<double, 2> wind,
             In<double, 1> pressure, int threads) {
  const auto& g = solver.geometry();
  const std::size_t batch = x.shape(0), rows = g.rows, cols = g.cols;
  const std::size_t handles = solver.world().handles.size(), bodies = solver.world().bodies.size();
  const std::initializer_list<std::size_t> cloth = {batch, 3, rows, cols}, axes = {batch, bodies, 2, 3};
  need(shaped(x, cloth) && shaped(v, cloth) && shaped(x_out, cloth) && shaped(v_out, cloth),
       "positions and velocities must be (B, 3, H, W)");
  need(shaped(sheets, {batch, Sheet::kProperties}) && systems.size() == batch, "materials must be (B, 10), systems B");
  need(shaped(handle_x, {batch, handles, 3}) && shaped(handle_v, {batch, handles, 3}), "handles must be (B, N, 3)");
  need(shaped(body_x, axes) && shaped(body_v, axes) && shaped(body_x_end, axes) && shaped(body_v_end, axes),
       "colliders must be (B, C, 2, 3)");
  need(shaped(wind, {batch, 3}) && shaped(pressure, {batch}), "wind must be (B, 3), pressure (B,)");
  need(threads >= 1, "threads must be at least 1");
  const std::size_t n = 3 * rows * cols;
  std::vector<Frame<T>> frames(batch);
  for (std::size_t b = 0; b < batch; ++b) {
    const double* m = sheets.data() + Sheet::kProperties * b;
    const std::size_t h = b * handles * 3, c = b * bodies * 6;
    frames[b] = {x.data() + b * n,
                 v.data() + b * n,
                 x_out.data() + b * n,
                 v_out.data() + b * n,
                 Sheet{m[0], m[1], m[2], m[3], m[4], m[5], m[6], m[7], m[8], m[9]},
                 1,
                 handle_x.data() + h,
                 handle_v.data() + h,
                 body_x.data() + c,
                 body_v.data() + c,
                 body_x_end.data() + c,
                 body_v_end.data() + c,
                 wind.data() + 3 * b,
                 pressure.data()[b]};
  }
  nb::gil_scoped_release release;
  solver.advance(frames, systems, threads);
}

template <class T>
void make(Admm<T>* self, int rows, int cols, double row_length, double col_length, bool periodic, double frame_dt,
          double gravity, double thickness, double wind_normal, double wind_tangential, bool wind, bool pressure,
          std::vector<int> handles, const std::vector<std::string>& kinds, const std::vector<double>& radii,
          const std::vector<double>& frictions, int substeps, int iterations, double weight, In<double, 2> row_basis,
          In<double, 2> col_basis) {
  World world{frame_dt, gravity, thickness, wind_normal, wind_tangential, wind, pressure, std::move(handles), {}};
  for (std::size_t i = 0; i < kinds.size(); ++i)
    world.bodies.push_back({kinds[i] == "plane", radii.at(i), frictions.at(i)});
  for (int h : world.handles) need(h >= 0 && h < rows * cols, "a handle is not a vertex of the grid");
  const std::size_t r = rows, c = cols;
  need(shaped(row_basis, {r, r}) && shaped(col_basis, {c, c}), "bases must be (H, H) and (W, W)");
  need(substeps >= 1 && iterations >= 1, "substeps and iterations must be at least 1");
  new (self) Admm<T>(Geometry<T>(rows, cols, row_length, col_length, periodic), std::move(world), substeps, iterations,
                     weight, row_basis.data(), col_basis.data());
}

template <class T>
void bind(nb::module_& m, const char* name, const char* system) {
  nb::class_<System<T>>(m, system);
  nb::class_<Admm<T>>(m, name)
      .def("__init__", &make<T>, nb::kw_only(), nb::arg("rows"), nb::arg("cols"), nb::arg("row_length"),
           nb::arg("col_length"), nb::arg("periodic"), nb::arg("frame_dt"), nb::arg("gravity"), nb::arg("thickness"),
           nb::arg("wind_normal"), nb::arg("wind_tangential"), nb::arg("wind"), nb::arg("pressure"), nb::arg("handles"),
           nb::arg("kinds"), nb::arg("radii"), nb::arg("frictions"), nb::arg("substeps"), nb::arg("iterations"),
           nb::arg("weight"), nb::arg("row_basis"), nb::arg("col_basis"))
      .def("system",
           [](const Admm<T>& self, In<double, 2> eigenvalues, In<double, 2> capacitance) {
             const std::size_t held = self.world().handles.size();
             need(shaped(eigenvalues, {std::size_t(self.geometry().rows), std::size_t(self.geometry().cols)}) &&
                      shaped(capacitance, {held, held}),
                  "eigenvalues must be (H, W), the capacitance (N, N)");
             return std::make_shared<System<T>>(self.system(eigenvalues.data(), capacitance.data()));
           })
      .def("solve",
           [](const Admm<T>& self, const System<T>& system, In<T, 3> right, Out<T, 3> x) {
             const std::initializer_list<std::size_t> cloth = {3, std::size_t(self.geometry().rows),
                                                               std::size_t(self.geometry().cols)};
             need(shaped(right, cloth) && shaped(x, cloth), "right-hand side and solution must be (3, H, W)");
             self.solve(system, right.data(), x.data());
           })
      .def("advance", &advance<T>);
}

}  // namespace

void bind_admm(nb::module_& m) {
  bind<float>(m, "Admm32", "AdmmSystem32");
  bind<double>(m, "Admm64", "AdmmSystem64");
}

}  // namespace minicloth
