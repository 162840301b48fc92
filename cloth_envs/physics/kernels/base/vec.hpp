// Three numbers.
#pragma once

namespace minicloth {

template <class T>
struct Vec {
  T x, y, z;
};
template <class T>
Vec<T> vec(const T* p) {
  return {p[0], p[1], p[2]};
}
template <class T>
Vec<T> operator+(const Vec<T>& a, const Vec<T>& b) {
  return {a.x + b.x, a.y + b.y, a.z + b.z};
}
template <class T>
Vec<T> operator-(const Vec<T>& a, const Vec<T>& b) {
  return {a.x - b.x, a.y - b.y, a.z - b.z};
}
template <class T>
Vec<T> operator*(T s, const Vec<T>& a) {
  return {s * a.x, s * a.y, s * a.z};
}
template <class T>
Vec<T> operator/(const Vec<T>& a, T s) {
  return {a.x / s, a.y / s, a.z / s};
}
template <class T>
T dot(const Vec<T>& a, const Vec<T>& b) {
  return a.x * b.x + a.y * b.y + a.z * b.z;
}
template <class T>
Vec<T> cross(const Vec<T>& a, const Vec<T>& b) {
  return {a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x};
}

}  // namespace minicloth
