// Crossing parts of a cloth go back through each other, in substeps of the explicit solver.
#pragma once
#include <vector>

#include "../explicit/core.hpp"
#include "contours.hpp"

namespace minicloth {

// Edges leave the triangles that they go through, the cloth around is smoothed and kept from being stretched. All of it
// is exchanged between vertices, by their masses: momentum is kept, and what is firmly held stays.
template <class T>
class Untangle {
 public:
  void shape(const Sheet& sheet);
  // What crosses, of positions in three planes and the pairs of cells that may.
  void find(const T* x, std::size_t plane, const std::vector<MeetingCells>& cells);
  bool any() const { return !hits_.empty(); }
  // How many pairs of triangles cross.
  int pairs() const { return contours_.pairs(); }
  // Whether contact of two cells has to wait.
  bool off(int first, int second) const { return any() && contours_.near(first, second); }
  // At the end of a step of `h`, of the cloth in lane `member` of `f`; `mobility` of its elements.
  void step(const Fields<T>& f, const Strips<T>& s, int member, const std::vector<T>& mobility, T h, T damping);

 private:
  struct Edge {
    int ends[2];
    T rest;  // m
  };
  // Vertices, and what they share in a distance sum share_i x_i.
  template <int most>
  struct Points {
    int count = 0, at[most];
    T share[most];
    void add(int vertex, T part) { at[count] = vertex, share[count++] = part; }
  };
  template <int most>
  Vec<T> sum(const T* field, const Points<most>& points) const;
  template <int most>
  void change(const Points<most>& points, const Vec<T>& kick, const Vec<T>& shift);
  Vec<T> get(const T* field, int vertex) const;
  void gather_edges();
  void smooth(int vertex);
  void part(const Hit& hit);
  void shorten(const Edge& edge);

  Contours contours_;
  std::vector<Hit> hits_;
  std::vector<int> crowd_;  // of vertices: in how many hits
  std::vector<char> around_;
  std::vector<Edge> edges_;  // around hits
  int rows_ = 0, cols_ = 0;
  bool periodic_ = false;
  T rest_[3] = {};  // m, along rows, columns and diagonals
  Fields<T> f_;
  const Strips<T>* strips_ = nullptr;
  const T* mobility_ = nullptr;
  int member_ = 0;
  T h_ = 0, damping_ = 0;
};

}  // namespace minicloth
