// The Python module _minicloth_kernels.
#define MINICLOTH_IMPORTS_NUMPY
#include <nanobind/stl/string.h>
#include <nanobind/stl/tuple.h>
#include <nanobind/stl/vector.h>

#include <string>

#include "admm.hpp"
#include "arrays.hpp"
#include "correct.hpp"
#include "episode.hpp"
#include "explicit.hpp"
#include "implicit.hpp"
#include "particles.hpp"
#include "resample.hpp"
#include "upscale.hpp"

namespace nb = nanobind;
using namespace minicloth;

namespace {

template <class T>
void advance(const Explicit<T>& solver, In<T, 4> x, In<T, 4> v, Out<T, 4> x_out, Out<T, 4> v_out, In<double, 2> sheets,
             In<int, 1> substeps, In<double, 3> handle_x, In<double, 3> handle_v, In<T, 4> body_x, In<T, 4> body_v,
             In<double, 4> body_x_end, In<double, 4> body_v_end, In<double, 2> wind, In<double, 1> pressure,
             int threads) {
  const auto& g = solver.geometry();
  const std::size_t batch = x.shape(0), rows = g.rows, cols = g.cols;
  const std::size_t handles = solver.world().handles.size(), bodies = solver.world().bodies.size();
  const std::initializer_list<std::size_t> cloth = {batch, 3, rows, cols}, axes = {batch, bodies, 2, 3};
  need(shaped(x, cloth) && shaped(v, cloth) && shaped(x_out, cloth) && shaped(v_out, cloth),
       "positions and velocities must be (B, 3, H, W)");
  need(shaped(sheets, {batch, Sheet::kProperties}) && shaped(substeps, {batch}),
       "materials must be (B, 10), substeps (B,)");
  need(shaped(handle_x, {batch, handles, 3}) && shaped(handle_v, {batch, handles, 3}), "handles must be (B, N, 3)");
  need(shaped(body_x, axes) && shaped(body_v, axes) && shaped(body_x_end, axes) && shaped(body_v_end, axes),
       "colliders must be (B, C, 2, 3)");
  need(shaped(wind, {batch, 3}) && shaped(pressure, {batch}), "wind must be (B, 3), pressure (B,)");
  need(threads >= 1, "threads must be at least 1");

  const std::size_t n = 3 * rows * cols;
  std::vector<Frame<T>> frames(batch);
  for (std::size_t b = 0; b < batch; ++b) {
    const double* m = sheets.data() + Sheet::kProperties * b;
    need(substeps.data()[b] >= 1, "substeps must be at least 1");
    frames[b] = {x.data() + b * n,
                 v.data() + b * n,
                 x_out.data() + b * n,
                 v_out.data() + b * n,
                 Sheet{m[0], m[1], m[2], m[3], m[4], m[5], m[6], m[7], m[8], m[9]},
                 substeps.data()[b],
                 handle_x.data() + b * handles * 3,
                 handle_v.data() + b * handles * 3,
                 body_x.data() + b * bodies * 6,
                 body_v.data() + b * bodies * 6,
                 body_x_end.data() + b * bodies * 6,
                 body_v_end.data() + b * bodies * 6,
                 wind.data() + 3 * b,
                 pressure.data()[b]};
  }
  nb::gil_scoped_release release;
  solver.advance(frames, threads);
}

template <class T>
void bind_solver(nb::module_& m, const char* name) {
  nb::class_<Explicit<T>>(m, name)
      .def(
          "__init__",
          [](Explicit<T>* self, int rows, int cols, double row_length, double col_length, bool periodic,
             double frame_dt, double gravity, double thickness, double wind_normal, double wind_tangential, bool wind,
             bool pressure, std::vector<int> handles, const std::vector<std::string>& kinds,
             const std::vector<double>& radii, const std::vector<double>& frictions) {
            World world{frame_dt, gravity,  thickness,          wind_normal, wind_tangential,
                        wind,     pressure, std::move(handles), {}};
            for (std::size_t i = 0; i < kinds.size(); ++i)
              world.bodies.push_back({kinds[i] == "plane", radii.at(i), frictions.at(i)});
            for (int h : world.handles) need(h >= 0 && h < rows * cols, "a handle is not a vertex of the grid");
            new (self) Explicit<T>(Geometry<T>(rows, cols, row_length, col_length, periodic, true), std::move(world));
          },
          nb::kw_only(), nb::arg("rows"), nb::arg("cols"), nb::arg("row_length"), nb::arg("col_length"),
          nb::arg("periodic"), nb::arg("frame_dt"), nb::arg("gravity"), nb::arg("thickness"), nb::arg("wind_normal"),
          nb::arg("wind_tangential"), nb::arg("wind"), nb::arg("pressure"), nb::arg("handles"), nb::arg("kinds"),
          nb::arg("radii"), nb::arg("frictions"))
      .def("advance", &advance<T>);
}

template <class T>
void bind_state(nb::module_& m) {
  m.def(
      "inspect",
      [](In<T, 4> x, In<T, 4> v, double row_length, double col_length, bool periodic) {
        const std::size_t batch = x.shape(0), n = 3 * x.shape(2) * x.shape(3);
        std::vector<std::tuple<bool, double, double>> all;
        for (std::size_t b = 0; b < batch; ++b) {
          const Check c = best_lanes<T>().check(x.data() + b * n, v.data() + b * n, int(x.shape(2)), int(x.shape(3)),
                                                T(row_length), T(col_length), periodic);
          all.emplace_back(c.finite, c.strain, c.kinetic);
        }
        return all;
      },
      "Per cloth: all finite, largest structural strain, kinetic energy per mass [J/kg].");
  m.def(
      "gather",
      [](In<T, 4> x, In<T, 4> v, In<int, 1> vertices, In<float, 1> bound, Out<float, 2> out) {
        const std::size_t batch = x.shape(0), n = x.shape(2) * x.shape(3), count = vertices.shape(0);
        need(out.shape(0) == batch && out.shape(1) == bound.shape(0) && 6 * count <= out.shape(1),
             "out must be (B, size of bound), with room for 6 numbers a vertex");
        const auto clip = [](float a, float limit) { return a < -limit ? -limit : a > limit ? limit : a; };
        for (std::size_t b = 0; b < batch; ++b) {
          float* to = out.data() + b * out.shape(1);
          for (std::size_t k = 0; k < 6; ++k) {
            const T* from = (k < 3 ? x.data() + (3 * b + k) * n : v.data() + (3 * b + k - 3) * n);
            for (std::size_t i = 0; i < count; ++i) to[k * count + i] = float(from[vertices.data()[i]]);
          }
          for (std::size_t i = 0; i < out.shape(1); ++i) to[i] = clip(to[i], bound.data()[i]);
        }
      },
      "Writes positions, then velocities of some vertices to the front of each row of out, and clips the whole row.");
}

}  // namespace

NB_MODULE(_minicloth_kernels, m) {
  if (_import_array() < 0) nb::raise_python_error();
  m.doc() = "Compiled loops of MiniCloth.";
  bind_solver<float>(m, "Explicit32");
  bind_solver<double>(m, "Explicit64");
  bind_state<float>(m);
  bind_state<double>(m);
  bind_episode(m);
  bind_admm(m);
  bind_implicit(m);
  bind_particles(m);
  bind_resample(m);
  bind_correct(m);
  bind_upscale(m);
  m.def("instruction_set", &best_lanes_name, "The instruction set that the kernels run on this processor.");
}
