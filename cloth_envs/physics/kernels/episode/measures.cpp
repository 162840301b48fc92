// What a reward measures: loops over a few numbers, each of which NumPy would do in several calls that cost more than
// the work.
#include <algorithm>
#include <cmath>

#include "../base/arrays.hpp"
#include "../module.hpp"

namespace nb = nanobind;

namespace minicloth {
namespace {

template <class T>
using Cloth = In<T, 4>;
using Vertices = In<int, 1>;

// The mean of f over some vertices, for each axis of each cloth.
template <class T, class F>
Array mean_of(const Cloth<T>& x, const Vertices& vertices, const F& f) {
  const std::size_t batch = x.shape(0), n = x.shape(2) * x.shape(3), count = vertices.shape(0);
  Array out = fresh({batch, 3});
  for (std::size_t row = 0; row < 3 * batch; ++row) {
    double sum = 0;
    for (std::size_t i = 0; i < count; ++i) sum += f(double(x.data()[row * n + vertices.data()[i]]));
    out.data()[row] = sum / double(count);
  }
  return out;
}
template <class T>
Array mean_point(Cloth<T> x, Vertices vertices) {
  return mean_of(x, vertices, [](double a) { return a; });
}
// Root of the mean over some vertices of the squares of the components first to last - 1, (B,).
template <class T>
Array root_mean_square(Cloth<T> x, Vertices vertices, std::size_t first, std::size_t last) {
  const Array squares = mean_of(x, vertices, [](double a) { return a * a; });
  Array out = fresh({x.shape(0)});
  for (std::size_t b = 0; b < x.shape(0); ++b) {
    for (std::size_t k = first; k < std::min<std::size_t>(last, 3); ++k) out.data()[b] += squares.data()[3 * b + k];
    out.data()[b] = std::sqrt(out.data()[b]);
  }
  return out;
}

// A Gaussian of a squared error over the squared margin, 0.1 where it is 1, squeezed to what lies above `least`.
double gaussian(double square, double least) { return least + (1 - least) * std::exp(std::log(0.1) * square); }

template <class T>
Array tolerance(Strided<T, 1> error, double margin, double least) {
  Array out = fresh({error.shape(0)});
  for (std::size_t b = 0; b < error.shape(0); ++b) {
    const double e = double(error(b)) / margin;
    out.data()[b] = gaussian(e * e, least);
  }
  return out;
}
// The same of the lengths of errors (B, n).
template <class T>
Array tolerance_of_length(Strided<T, 2> error, double margin, double least) {
  Array out = fresh({error.shape(0)});
  for (std::size_t b = 0; b < error.shape(0); ++b) {
    double sum = 0;
    for (std::size_t k = 0; k < error.shape(1); ++k) sum += double(error(b, k)) * double(error(b, k));
    out.data()[b] = gaussian(sum / (margin * margin), least);
  }
  return out;
}

// How much of `full` a value is, within 0 and 1.
Array ramp(Strided<double, 1> value, double full) {
  Array out = fresh({value.shape(0)});
  for (std::size_t b = 0; b < value.shape(0); ++b) out.data()[b] = std::min(std::max(value(b) / full, 0.0), 1.0);
  return out;
}

// The part of vectors (B, 3) along a level direction (B, 2).
Array along(Strided<double, 2> vector, Strided<double, 2> direction) {
  const std::size_t batch = vector.shape(0);
  need(vector.shape(1) == 3 && shaped(direction, {batch, 2}), "vectors must be (B, 3), directions (B, 2)");
  Array out = fresh({batch});
  for (std::size_t b = 0; b < batch; ++b)
    out.data()[b] = vector(b, 0) * direction(b, 0) + vector(b, 1) * direction(b, 1);
  return out;
}

// The mean of x[second] - x[first] over pairs of vertices, (B, 3).
template <class T>
Array mean_span(Cloth<T> x, Vertices first, Vertices second) {
  const std::size_t batch = x.shape(0), n = x.shape(2) * x.shape(3), count = first.shape(0);
  if (second.shape(0) != count) throw nb::value_error("first and second must be as many");
  Array out = fresh({batch, 3});
  for (std::size_t row = 0; row < 3 * batch; ++row) {
    const T* axis = x.data() + row * n;
    double sum = 0;
    for (std::size_t i = 0; i < count; ++i) sum += double(axis[second.data()[i]]) - axis[first.data()[i]];
    out.data()[row] = sum / double(count);
  }
  return out;
}

// The area vector, sum of x_i cross x_(i+1) over two, of a closed line through some vertices, (B, 3).
template <class T>
Array loop_area(Cloth<T> x, Vertices loop) {
  const std::size_t batch = x.shape(0), n = x.shape(2) * x.shape(3), count = loop.shape(0);
  Array out = fresh({batch, 3});
  for (std::size_t b = 0; b < batch; ++b)
    for (std::size_t k = 0; k < 3; ++k) {
      const T *u = x.data() + (3 * b + (k + 1) % 3) * n, *w = x.data() + (3 * b + (k + 2) % 3) * n;
      double sum = 0;
      for (std::size_t i = 0; i < count; ++i) {
        const int here = loop.data()[i], next = loop.data()[i + 1 < count ? i + 1 : 0];
        sum += double(u[here]) * w[next] - double(w[here]) * u[next];
      }
      out.data()[3 * b + k] = sum / 2;
    }
  return out;
}

// The largest stretch |x_second - x_first| / rest of some pairs of vertices, (B,).
template <class T>
Array largest_stretch(Cloth<T> x, Vertices first, Vertices second, In<double, 1> rest) {
  const std::size_t batch = x.shape(0), n = x.shape(2) * x.shape(3), count = first.shape(0);
  if (second.shape(0) != count || rest.shape(0) != count) throw nb::value_error("pairs and rest lengths differ");
  Array out = fresh({batch});
  for (std::size_t b = 0; b < batch; ++b)
    for (std::size_t i = 0; i < count; ++i) {
      double square = 0;
      for (std::size_t k = 0; k < 3; ++k) {
        const T* axis = x.data() + (3 * b + k) * n;
        const double d = double(axis[second.data()[i]]) - axis[first.data()[i]];
        square += d * d;
      }
      out.data()[b] = std::max(out.data()[b], std::sqrt(square) / rest.data()[i]);
    }
  return out;
}

template <class T>
void bind_measures_of(nb::module_& m) {
  m.def("mean_span", &mean_span<T>, "The mean of x[second] - x[first] over pairs of vertices, (B, 3).");
  m.def("loop_area", &loop_area<T>, "The area vector of a closed line through some vertices, (B, 3) [m^2].");
  m.def("largest_stretch", &largest_stretch<T>, "The largest length over rest length of some pairs of vertices, (B,).");
  m.def("mean_point", &mean_point<T>, "The mean of some vertices of (B, 3, H, W), (B, 3), float64.");
  m.def("root_mean_square", &root_mean_square<T>, nb::arg("field"), nb::arg("vertices"), nb::arg("first") = 0,
        nb::arg("last") = 3, "Root mean square over some vertices of some components of (B, 3, H, W), (B,), float64.");
  m.def("tolerance", &tolerance<T>, nb::arg("error"), nb::arg("margin"), nb::arg("least") = 0.0,
        "least + (1 - least) times a Gaussian of an error (B,), 1 at 0 and 0.1 at the margin; float64.");
  m.def("tolerance", &tolerance_of_length<T>, nb::arg("error"), nb::arg("margin"), nb::arg("least") = 0.0,
        "The same of the lengths of errors (B, n).");
}

}  // namespace

void bind_measures(nb::module_& m) {
  m.def("ramp", &ramp, "How much of a full value each (B,) is, within 0 and 1.");
  m.def("along", &along, "The part of vectors (B, 3) along a level direction (B, 2), (B,).");
  bind_measures_of<float>(m);
  bind_measures_of<double>(m);
}

}  // namespace minicloth
