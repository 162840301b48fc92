// Crossing triangles for Python.
#include <nanobind/nanobind.h>

#include <cmath>
#include <memory>

#include "../base/arrays.hpp"
#include "../base/threads.hpp"
#include "../module.hpp"
#include "count.hpp"

namespace nb = nanobind;

namespace minicloth {

namespace {

// Of every cloth the pairs of triangles.
template <class T>
std::vector<std::vector<Crossings::Pair>> find(const In<T, 4>& positions, bool periodic, int threads) {
  const std::size_t batch = positions.shape(0), rows = positions.shape(2), cols = positions.shape(3);
  need(positions.shape(1) == 3 && rows >= 2 && cols >= (periodic ? 3 : 2), "positions must be (B, 3, H, W)");
  need(threads >= 1, "threads must be at least 1");
  for (const T *x = positions.data(), *end = x + positions.size(); x != end; ++x)
    if (!std::isfinite(*x)) throw nb::value_error("positions must be finite, they hold NaN or infinity");
  std::vector<std::vector<Crossings::Pair>> found(batch);
  const nb::gil_scoped_release released;
  for_each_member(batch, threads, [&](std::size_t b) {
    Crossings crossings(static_cast<int>(rows), static_cast<int>(cols), periodic);
    found[b] = crossings.find(positions.data() + b * 3 * rows * cols);
  });
  return found;
}

template <class T>
Fresh<std::int64_t> counted(const In<T, 4>& positions, bool periodic, int threads) {
  const auto found = find<T>(positions, periodic, threads);
  const auto out = empty<std::int64_t>({found.size()});
  for (std::size_t b = 0; b < found.size(); ++b) out.data()[b] = std::int64_t(found[b].size());
  return out;
}

template <class T>
Fresh<std::int64_t> listed(const In<T, 4>& positions, bool periodic, int threads) {
  const auto found = find<T>(positions, periodic, threads);
  std::size_t count = 0;
  for (const auto& pairs : found) count += pairs.size();
  const auto out = empty<std::int64_t>({count, 3});
  std::int64_t* row = out.data();
  for (std::size_t b = 0; b < found.size(); ++b)
    for (const auto& pair : found[b]) *row++ = std::int64_t(b), *row++ = pair[0], *row++ = pair[1];
  return out;
}

template <class T>
void bind(nb::module_& m) {
  m.def(
      "crossing_triangles", &counted<T>, nb::arg("positions"), nb::kw_only(), nb::arg("periodic") = false,
      nb::arg("threads") = 1,
      "How many pairs of the triangles of Grid.triangles cross in each cloth, (B,) of positions (B, 3, H, W): an edge "
      "of one crosses the inside of the other, and they have no vertex in common.");
  m.def("crossing_pairs", &listed<T>, nb::arg("positions"), nb::kw_only(), nb::arg("periodic") = false,
        nb::arg("threads") = 1,
        "The pairs that crossing_triangles counts, (N, 3) in ascending order: the cloth and two triangles.");
}

}  // namespace

void bind_count(nb::module_& m) {
  bind<float>(m);
  bind<double>(m);
}

}  // namespace minicloth
