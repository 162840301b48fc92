// Which of two functions a call is for: a kernel, of NumPy arrays, or its source, of all else. A function of Python's
// that asked would cost as much as the smallest kernels.
#include "../base/arrays.hpp"
#include "../module.hpp"

namespace nb = nanobind;

namespace minicloth {
namespace {

PyObject* choose(PyObject* both, PyObject* const* arguments, Py_ssize_t count) {
  const bool source = count == 0 || !PyArray_Check(arguments[0]);
  return PyObject_Vectorcall(PyTuple_GET_ITEM(both, source), arguments, std::size_t(count), nullptr);
}

PyMethodDef choosing = {"choose", reinterpret_cast<PyCFunction>(reinterpret_cast<void (*)()>(choose)), METH_FASTCALL,
                        "A kernel where the first argument is a NumPy array, and its source where it is none."};

nb::object with_source(nb::callable kernel, nb::callable source) {
  PyObject* function = PyCFunction_New(&choosing, nb::make_tuple(kernel, source).ptr());
  if (!function) nb::raise_python_error();
  return nb::steal(function);
}

}  // namespace

void bind_choose(nb::module_& m) {
  m.def("with_source", &with_source,
        "A function that calls the kernel where its first argument is a NumPy array, and the source where it is none.");
}

}  // namespace minicloth
