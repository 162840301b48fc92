// Crossing parts of a cloth go back through each other, in substeps of the explicit solver.
#pragma once
#include <vector>

#include "../explicit/core.hpp"
#include "contours.hpp"

namespace minicloth {

template <class T>
class Untangle {
 public:
  void shape(const Sheet& sheet);
  // Whether anything crosses, of positions in three planes and the pairs of cells that may.
  bool find(const T* x, std::size_t plane, const std::vector<std::array<int, 2>>& cells);
  bool any() const { return hits_ != nullptr; }
  int pairs() const { return hits_ ? contours_.pairs() : 0; }
  // Whether contact of two cells has to wait.
  bool off(int first, int second) const { return hits_ && contours_.near(first, second); }
  void step(const Fields<T>& f, const Strips<T>& s, int member, const std::vector<T>& mobility, T h, T damping);

 private:
  void smooth();
  void part(const Hit& hit);
  void strain();
  void limit();
  struct Pull {
    int a, b;
    T rest;
  };
  Contours contours_;
  const std::vector<Hit>* hits_ = nullptr;
  std::vector<int> crowd_;
  std::vector<T> slack_;
  std::vector<Pull> edges_;
  T rest_[3];
  Fields<T> f_;
  const Strips<T>* s_;
  const T* mobility_;
  int member_, rows_, cols_;
  bool periodic_;
  T h_, damping_;
};

}  // namespace minicloth
