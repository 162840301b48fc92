// What environments ask of a state.
#include <nanobind/stl/tuple.h>
#include <nanobind/stl/vector.h>

#include <algorithm>

#include "../base/arrays.hpp"
#include "../module.hpp"
#include "core.hpp"

namespace nb = nanobind;

namespace minicloth {
namespace {

// Numbers (B,) or (B, n) side by side, float32.
Fresh<float> columns(nb::args parts) {
  const auto array = [](nb::handle part) { return reinterpret_cast<PyArrayObject*>(part.ptr()); };
  std::size_t n = 0, batch = 0;
  for (nb::handle part : parts) {
    if (!Strided<float, 1>::fits(part.ptr()) && !Strided<double, 1>::fits(part.ptr()) &&
        !Strided<float, 2>::fits(part.ptr()) && !Strided<double, 2>::fits(part.ptr()))
      throw nb::type_error("every part must be float32 or float64, (B,) or (B, n)");
    const auto* a = array(part);
    if (n > 0 && std::size_t(PyArray_DIM(a, 0)) != batch) throw nb::value_error("parts must be of one batch");
    batch = PyArray_DIM(a, 0), n += PyArray_NDIM(a) == 1 ? 1 : PyArray_DIM(a, 1);
  }
  const Fresh<float> out = fresh<float>({batch, n});
  float* to = out.data();
  const auto copy = [&](PyArrayObject* a, const auto* from) {
    const bool wide = PyArray_NDIM(a) == 2;
    const npy_intp row = PyArray_STRIDE(a, 0) / npy_intp(sizeof *from), width = wide ? PyArray_DIM(a, 1) : 1;
    const npy_intp step = wide ? PyArray_STRIDE(a, 1) / npy_intp(sizeof *from) : 0;
    for (npy_intp b = 0; b < npy_intp(batch); ++b)
      for (npy_intp k = 0; k < width; ++k) to[b * npy_intp(n) + k] = float(from[b * row + k * step]);
    to += width;
  };
  for (nb::handle part : parts) {
    auto* a = array(part);
    if (PyArray_TYPE(a) == NPY_FLOAT)
      copy(a, static_cast<const float*>(PyArray_DATA(a)));
    else
      copy(a, static_cast<const double*>(PyArray_DATA(a)));
  }
  return out;
}

template <class T>
void bind_state_of(nb::module_& m) {
  m.def(
      "inspect",
      [](In<T, 4> x, In<T, 4> v, double row_length, double col_length, bool periodic) {
        const std::size_t batch = x.shape(0), n = 3 * x.shape(2) * x.shape(3);
        std::vector<std::tuple<bool, double, double>> all;
        for (std::size_t b = 0; b < batch; ++b) {
          const Check c = lanes<StateLanes<T>>().check(x.data() + b * n, v.data() + b * n, int(x.shape(2)),
                                                       int(x.shape(3)), T(row_length), T(col_length), periodic);
          all.emplace_back(c.finite, c.strain, c.kinetic);
        }
        return all;
      },
      "Per cloth: all finite, largest structural strain, kinetic energy per mass [J/kg].");
  m.def(
      "next_frame",
      [](In<T, 4> x, In<double, 1> time, In<double, 4> bodies, In<double, 4> moving, double dt) {
        const std::size_t batch = x.shape(0);
        need(time.shape(0) == batch, "times must be (B,)");
        const auto blank = [&] { return empty<T>({batch, x.shape(1), x.shape(2), x.shape(3)}); };
        const auto rounded = [](const In<double, 4>& from) {
          const Fresh<T> to = empty<T>({from.shape(0), from.shape(1), from.shape(2), from.shape(3)});
          std::copy_n(from.data(), from.size(), to.data());
          return to;
        };
        const Array later = empty({batch});
        for (std::size_t b = 0; b < batch; ++b) later.data()[b] = time.data()[b] + dt;
        return nb::make_tuple(blank(), blank(), rounded(bodies), rounded(moving), later);
      },
      nb::arg("positions").noconvert(), nb::arg("time"), nb::arg("colliders"), nb::arg("collider_velocities"),
      nb::arg("dt"),
      "Positions and velocities to fill, bodies and their velocities as controls have them, the time a frame later.");
  m.def(
      "gather",
      [](In<T, 4> x, In<T, 4> v, In<int, 1> vertices, In<float, 2> extras, In<float, 1> bound) {
        const std::size_t batch = x.shape(0), n = x.shape(2) * x.shape(3), count = vertices.shape(0);
        const std::size_t more = extras.shape(1), width = 6 * count + more;
        need(shaped(extras, {batch, more}) && bound.shape(0) == width,
             "bound must be of 6 numbers a vertex and extras");
        const Fresh<float> out = fresh<float>({batch, width});
        const auto clip = [](float a, float limit) { return a < -limit ? -limit : a > limit ? limit : a; };
        float* to = out.data();
        for (std::size_t b = 0; b < batch; ++b, to += width) {
          for (std::size_t k = 0; k < 6; ++k) {
            const T* from = (k < 3 ? x.data() + (3 * b + k) * n : v.data() + (3 * b + k - 3) * n);
            for (std::size_t i = 0; i < count; ++i) to[k * count + i] = float(from[vertices.data()[i]]);
          }
          std::copy_n(extras.data() + b * more, more, to + 6 * count);
          for (std::size_t i = 0; i < width; ++i) to[i] = clip(to[i], bound.data()[i]);
        }
        return out;
      },
      "Positions, then velocities of some vertices, then the extras (B, K), all clipped: (B, 6 N + K) float32.");
}

}  // namespace

void bind_state(nb::module_& m) {
  bind_state_of<float>(m);
  bind_state_of<double>(m);
  m.def("columns", &columns, "Numbers (B,) or (B, n) side by side, (B, N) float32.");
  m.def(
      "tick",
      [](Out<std::int64_t, 1> frames, double dt, Out<double, 1> time) {
        need(frames.shape(0) == time.shape(0), "frames and time must be (B,)");
        for (std::size_t b = 0; b < frames.shape(0); ++b) time.data()[b] = double(++frames.data()[b]) * dt;
      },
      "Counts one frame more, and writes the time that it ends at.");
}

}  // namespace minicloth
