// NumPy arrays as arguments of the compiled solvers.
#pragma once
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>

#include <cstddef>
#include <initializer_list>
#include <stdexcept>
#include <string>

namespace minicloth {

template <class T, int kDims>
using In = nanobind::ndarray<const T, nanobind::ndim<kDims>, nanobind::c_contig, nanobind::device::cpu>;
template <class T, int kDims>
using Out = nanobind::ndarray<T, nanobind::ndim<kDims>, nanobind::c_contig, nanobind::device::cpu>;

using Array = nanobind::ndarray<nanobind::numpy, double>;

// An array of zeros.
inline Array fresh(std::initializer_list<std::size_t> shape) {
  std::size_t size = 1;
  for (std::size_t n : shape) size *= n;
  auto* data = new double[size]();
  nanobind::capsule owner(data, [](void* p) noexcept { delete[] static_cast<double*>(p); });
  return Array(data, shape, owner);
}

inline void need(bool good, const char* what) {
  if (!good) throw std::invalid_argument(std::string("wrong shape: ") + what);
}

template <class A>
bool shaped(const A& a, std::initializer_list<std::size_t> shape) {
  std::size_t k = 0;
  for (std::size_t n : shape)
    if (a.shape(k++) != n) return false;
  return true;
}

}  // namespace minicloth
