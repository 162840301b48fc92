// What an environment does around the solver at every step: loops over a few numbers, each of which NumPy
// would do in several calls that cost more than the work.
#include "episode.hpp"

#include <algorithm>
#include <cmath>
#include <vector>

#include "arrays.hpp"

namespace nb = nanobind;

namespace minicloth {
namespace {

template <class T>
using Cloth = In<T, 4>;
using Vertices = In<int, 1>;
using Row = In<double, 1>;
template <class T>
using Pairs = Strided<T, 2>;

template <class T>
Array take_points(Cloth<T> x, Vertices vertices) {
  const std::size_t batch = x.shape(0), n = x.shape(2) * x.shape(3), count = vertices.shape(0);
  Array out = fresh({batch, count, 3});
  double* to = out.data();
  for (std::size_t b = 0; b < batch; ++b)
    for (std::size_t i = 0; i < count; ++i)
      for (std::size_t k = 0; k < 3; ++k) *to++ = x.data()[(3 * b + k) * n + vertices.data()[i]];
  return out;
}

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
Array tolerance_of_length(Pairs<T> error, double margin, double least) {
  Array out = fresh({error.shape(0)});
  for (std::size_t b = 0; b < error.shape(0); ++b) {
    double sum = 0;
    for (std::size_t k = 0; k < error.shape(1); ++k) sum += double(error(b, k)) * double(error(b, k));
    out.data()[b] = gaussian(sum / (margin * margin), least);
  }
  return out;
}

using Tones = In<double, 4>;
using Numbers = Strided<double, 1>;

// The mean of the sines of signal s of cloth b at a time.
double blow(const Tones& tones, std::size_t b, std::size_t s, double time) {
  const std::size_t count = tones.shape(3);
  double sum = 0;
  for (std::size_t i = 0; i < count; ++i) sum += std::sin(tones(b, 0, s, i) * time + tones(b, 1, s, i));
  return sum / double(count);
}

// Means of sines, (B, J): signal j of the tones (B, 2, S, N) at time j of (B, K), where S or K may be 1.
Array gust(Tones tones, Pairs<double> time) {
  const std::size_t batch = tones.shape(0), signals = tones.shape(2), times = time.shape(1);
  if (time.shape(0) != batch || (signals != times && signals != 1 && times != 1))
    throw nb::value_error("tones must be (B, 2, S, N), times (B, K) with S = K or either 1");
  const std::size_t n = std::max(signals, times);
  Array out = fresh({batch, n});
  for (std::size_t b = 0; b < batch; ++b)
    for (std::size_t j = 0; j < n; ++j)
      out.data()[b * n + j] = blow(tones, b, signals == 1 ? 0 : j, time(b, times == 1 ? 0 : j));
  return out;
}

// A level wind of a mean speed and heading whose first gust swells it and whose second turns it, (B, 3).
Array gusty_wind(Tones tones, Numbers time, Numbers speed, Numbers heading, double swell, double turn) {
  const std::size_t batch = tones.shape(0);
  if (tones.shape(2) != 2 || time.shape(0) != batch || speed.shape(0) != batch || heading.shape(0) != batch)
    throw nb::value_error("tones must be (B, 2, 2, N), times, speeds and headings (B,)");
  Array out = fresh({batch, 3});
  for (std::size_t b = 0; b < batch; ++b) {
    const double strength = speed(b) * (1 + swell * blow(tones, b, 0, time(b)));
    const double angle = heading(b) + turn * blow(tones, b, 1, time(b));
    out.data()[3 * b] = strength * std::cos(angle), out.data()[3 * b + 1] = strength * std::sin(angle);
  }
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

// Moves the handles (B, N, 3) of Controls: axis k of handle i takes share (i, k) of moved and reached (B, n).
void carry(Out<double, 3> handles, Out<double, 3> velocities, Pairs<double> moved, Pairs<double> reached,
           Pairs<double> share) {
  const std::size_t batch = moved.shape(0), n = moved.shape(1), count = share.shape(0);
  if (handles.size() != batch * count * 3 || share.shape(1) != n || n > 3)
    throw nb::value_error("share must be (N, n), moved (B, n) with n as driven");
  for (std::size_t b = 0; b < batch; ++b)
    for (std::size_t i = 0; i < count; ++i)
      for (std::size_t k = 0; k < n; ++k) {
        const std::size_t at = (b * count + i) * 3 + k;
        handles.data()[at] += moved(b, k) * share(i, k);
        velocities.data()[at] += reached(b, k) * share(i, k);
      }
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
Array largest_stretch(Cloth<T> x, Vertices first, Vertices second, Row rest) {
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

// What brings every handle and body to rest where it is: the arguments of Controls.
template <class T>
nb::tuple hold(Cloth<T> x, Vertices handles, Cloth<T> colliders) {
  const std::size_t batch = x.shape(0), bodies = colliders.shape(1);
  Array at = fresh({batch, bodies, 2, 3});
  std::copy_n(colliders.data(), colliders.size(), at.data());
  return nb::make_tuple(take_points(x, handles), fresh({batch, handles.shape(0), 3}), at, fresh({batch, bodies, 2, 3}),
                        fresh({batch, 3}), fresh({batch}));
}

// The velocity goes towards action * speed by at most `change`, slowing down within `brake` of a side.
template <class T>
nb::tuple drive(Pairs<T> position, Pairs<T> velocity, Pairs<double> action, Row low, Row high, Row speed, double change,
                double brake, double dt) {
  const std::size_t batch = position.shape(0), n = low.shape(0);
  if (position.shape(1) != n || velocity.shape(1) != n || action.shape(1) != n || high.shape(0) != n ||
      speed.shape(0) != n || velocity.shape(0) != batch || action.shape(0) != batch)
    throw nb::value_error("positions, velocities and actions must be (B, n) with n as in the box");
  Array moved = fresh({batch, n}), reached = fresh({batch, n});
  for (std::size_t b = 0; b < batch; ++b)
    for (std::size_t k = 0; k < n; ++k) {
      const double x = position(b, k), v = velocity(b, k);
      const double upper = std::max((high(k) - x) / brake, 0.0), lower = std::min((low(k) - x) / brake, 0.0);
      const double wanted = std::min(std::max(action(b, k) * speed(k), lower), upper);
      const double next = std::min(std::max(wanted, v - change), v + change);
      moved.data()[b * n + k] = 0.5 * dt * (v + next);
      reached.data()[b * n + k] = next;
    }
  return nb::make_tuple(moved, reached);
}

// Actions clipped to [-1, 1], or None if one is not finite.
nb::object clip_actions(Pairs<double> actions) {
  const std::size_t batch = actions.shape(0), n = actions.shape(1);
  Array out = fresh({batch, n});
  for (std::size_t b = 0; b < batch; ++b)
    for (std::size_t k = 0; k < n; ++k) {
      const double a = actions(b, k);
      if (!std::isfinite(a)) return nb::none();
      out.data()[b * n + k] = std::min(std::max(a, -1.0), 1.0);
    }
  return nb::cast(out);
}

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
void bind(nb::module_& m) {
  m.def("hold", &hold<T>, "The arrays of Controls that bring every handle and body to rest where it is.");
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
  m.def("drive", &drive<T>, "How far a driven thing moves in a frame, and its velocity at the end, (B, n) each.");
}

}  // namespace

void bind_episode(nb::module_& m) {
  bind<float>(m);
  bind<double>(m);
  m.def("columns", &columns, "Numbers (B,) or (B, n) side by side, (B, N) float32.");
  m.def("clip_actions", &clip_actions, "Actions (B, A) clipped to [-1, 1]; None if one is not finite.");
  m.def("gusty_wind", &gusty_wind, "A level wind (B, 3) whose two gusts change its strength and heading.");
  m.def("carry", &carry, "Moves handles in place by shares of how far and how fast something is driven.");
  m.def("gust", &gust, "Smooth signals in [-1, 1], (B, J), from tones (B, 2, S, N) at times (B, K).");
}

}  // namespace minicloth
