// NumPy arrays as arguments of the compiled solvers and as what they return, through NumPy's own C interface: a frame
// passes dozens of them, and the protocols for any library's arrays take half a microsecond each.
#pragma once
#include <nanobind/nanobind.h>
#define PY_ARRAY_UNIQUE_SYMBOL minicloth_numpy
#ifndef MINICLOTH_IMPORTS_NUMPY  // one file does, with import_array
#define NO_IMPORT_ARRAY
#endif
#define NPY_NO_DEPRECATED_API NPY_1_22_API_VERSION
#include <numpy/arrayobject.h>

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <initializer_list>
#include <stdexcept>
#include <string>
#include <type_traits>

namespace minicloth {

template <class T>
constexpr int kNumber = std::is_same_v<T, float>          ? NPY_FLOAT
                        : std::is_same_v<T, double>       ? NPY_DOUBLE
                        : std::is_same_v<T, std::int64_t> ? NPY_INT64
                                                          : NPY_INT;

// An array of somebody else, who keeps it alive meanwhile.
template <class T, int kDims, bool kContiguous = true>
class View {
 public:
  static constexpr bool kWritten = !std::is_const_v<T>;
  static constexpr int kNeeds = NPY_ARRAY_ALIGNED | NPY_ARRAY_NOTSWAPPED | (kContiguous ? NPY_ARRAY_C_CONTIGUOUS : 0) |
                                (kWritten ? NPY_ARRAY_WRITEABLE : 0);

  View() = default;
  explicit View(PyArrayObject* array) : data_(static_cast<T*>(PyArray_DATA(array))) {
    std::copy_n(PyArray_DIMS(array), kDims, shape_);
    for (int k = 0; k < kDims; ++k) strides_[k] = PyArray_STRIDE(array, k) / npy_intp(sizeof(T));
  }
  static bool fits(PyObject* object) {
    auto* array = reinterpret_cast<PyArrayObject*>(object);
    return PyArray_Check(object) && PyArray_NDIM(array) == kDims &&
           PyArray_EquivTypenums(PyArray_TYPE(array), kNumber<std::remove_const_t<T>>) &&
           PyArray_CHKFLAGS(array, kNeeds & ~NPY_ARRAY_NOTSWAPPED) && PyArray_ISNOTSWAPPED(array);
  }

  // The object itself or what it becomes when converted, a new reference; null with no error set where neither can be.
  static PyObject* fitting(PyObject* object, bool convert = true) {
    if (fits(object)) return Py_NewRef(object);
    if (kWritten || !convert) return nullptr;
    constexpr int type = kNumber<std::remove_const_t<T>>;
    PyObject* array = PyArray_FROMANY(object, type, kDims, kDims, kNeeds | NPY_ARRAY_FORCECAST);
    if (!array) PyErr_Clear();
    return array;
  }

  T* data() const { return data_; }
  std::size_t shape(int k) const { return std::size_t(shape_[k]); }
  std::size_t size() const {
    std::size_t all = 1;
    for (npy_intp n : shape_) all *= std::size_t(n);
    return all;
  }
  template <class... I>
  T& operator()(I... index) const {
    static_assert(sizeof...(index) == kDims);
    npy_intp at = 0, k = 0;
    ((at += npy_intp(index) * strides_[k++]), ...);
    return data_[at];
  }

 private:
  T* data_ = nullptr;
  npy_intp shape_[kDims] = {}, strides_[kDims] = {};
};

// To read, converted to T and C order if need be; to write, never converted; to read with any strides.
template <class T, int kDims>
using In = View<const T, kDims>;
template <class T, int kDims>
using Out = View<T, kDims>;
template <class T, int kDims>
using Strided = View<const T, kDims, false>;

// A new array, to return.
template <class T>
struct Fresh {
  nanobind::object array;
  T* data() const { return static_cast<T*>(PyArray_DATA(reinterpret_cast<PyArrayObject*>(array.ptr()))); }
};
using Array = Fresh<double>;

// An array of zeros, or of anything.
template <class T = double, bool kZeros = true>
Fresh<T> fresh(std::initializer_list<std::size_t> shape) {
  npy_intp sizes[NPY_MAXDIMS_LEGACY_ITERS];
  std::copy(shape.begin(), shape.end(), sizes);
  const int n = int(shape.size());
  PyObject* array = kZeros ? PyArray_ZEROS(n, sizes, kNumber<T>, 0) : PyArray_EMPTY(n, sizes, kNumber<T>, 0);
  if (!array) nanobind::raise_python_error();
  return {nanobind::steal(array)};
}
template <class T = double>
Fresh<T> empty(std::initializer_list<std::size_t> shape) {
  return fresh<T, false>(shape);
}

inline void need(bool good, const char* what) {
  if (!good) throw std::invalid_argument(std::string("wrong shape: ") + what);
}

template <class A>
bool shaped(const A& a, std::initializer_list<std::size_t> shape) {
  int k = 0;
  for (std::size_t n : shape)
    if (a.shape(k++) != n) return false;
  return true;
}

}  // namespace minicloth

namespace nanobind::detail {

template <class T, int kDims, bool kContiguous>
struct type_caster<minicloth::View<T, kDims, kContiguous>> {
  using Viewed = minicloth::View<T, kDims, kContiguous>;
  NB_TYPE_CASTER(Viewed, const_name("numpy.ndarray"))

  bool from_python(handle source, std::uint8_t flags, cleanup_list* cleanup) noexcept {
    PyObject* array = Viewed::fitting(source.ptr(), cleanup && (flags & std::uint8_t(cast_flags::convert)));
    if (!array) return false;
    if (array == source.ptr())
      Py_DECREF(array);  // whoever calls keeps it
    else
      cleanup->append(array);
    value = Viewed(reinterpret_cast<PyArrayObject*>(array));
    return true;
  }
};

template <class T>
struct type_caster<minicloth::Fresh<T>> {
  using Made = minicloth::Fresh<T>;
  NB_TYPE_CASTER(Made, const_name("numpy.ndarray"))
  bool from_python(handle, std::uint8_t, cleanup_list*) noexcept { return false; }
  static handle from_cpp(const Made& made, rv_policy, cleanup_list*) noexcept { return made.array.inc_ref(); }
};

}  // namespace nanobind::detail
