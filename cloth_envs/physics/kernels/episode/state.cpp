// What environments ask of a state.
#include <nanobind/stl/tuple.h>
#include <nanobind/stl/vector.h>

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

void bind_state(nb::module_& m) {
  bind_state_of<float>(m);
  bind_state_of<double>(m);
  m.def("columns", &columns, "Numbers (B,) or (B, n) side by side, (B, N) float32.");
}

}  // namespace minicloth
