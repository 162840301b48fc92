// Which parts of a cloth its contours cut off.
#include <algorithm>
#include <cstdlib>
#include <numeric>

#include "contours.hpp"

namespace minicloth {
namespace {

constexpr int kPocket = 40;  // vertices of a part in which contact waits, at most

}  // namespace

// Of every contour, which ends of its edges lie in the smaller part that it cuts off.
void Contours::regions() {
  order_.resize(hits_.size()), std::iota(order_.begin(), order_.end(), 0);
  std::sort(order_.begin(), order_.end(), [&](int i, int j) {
    return hits_[i].contour != hits_[j].contour ? hits_[i].contour < hits_[j].contour : i < j;
  });
  for (auto* marks : {&cut_, &region_, &pocket_}) std::fill(marks->begin(), marks->end(), 0);
  tangled_.clear(), size_.assign(1, 0);
  for (int first = 0, last; first < int(order_.size()); first = last) {
    int known = 0;
    for (last = first; last < int(order_.size()) && hits_[order_[last]].contour == hits_[order_[first]].contour;)
      ++last;
    sides(first, last);
    for (int k = first; k < last; ++k) known += hits_[order_[k]].inside >= 0;
    if (4 * known < last - first) close(first, last);
    for (int v = 0; v < rows_ * cols_; ++v) {
      if (region_[v] < stamp_ || size_[region_[v]] > kPocket) continue;
      tangled_.push_back(v);
      for (const int r : {v - cols_, v}) {  // cells around it
        const int l = r < 0 ? -1 : left(r);
        if (r >= 0) pocket_[r] = stamp_;
        if (l >= 0) pocket_[l] = stamp_;
      }
    }
  }
  for (const Hit& h : hits_) tangled_.insert(tangled_.end(), h.at.begin(), h.at.end());
  std::sort(tangled_.begin(), tangled_.end());
  tangled_.erase(std::unique(tangled_.begin(), tangled_.end()), tangled_.end());
}

void Contours::sides(int first, int last) {
  const int n = rows_ * cols_;
  stamp_ = int(size_.size());
  size_.push_back(n);  // of what is no region
  const double cuts = last - first;
  const int limit = int(std::min(n / 2.0, cuts * cuts + 4));
  for (int k = first; k < last; ++k) {
    int& cut = cut_[hits_[order_[k]].edge];
    cut = cut == stamp_ ? 0 : stamp_;
    if (stop_[order_[k]] >= 0) region_[stop_[order_[k]]] = stamp_;
  }
  for (int k = first; k < last; ++k)
    for (int end = 0; end < 2; ++end) flood(hits_[order_[k]].at[end], limit);
  for (int k = first; k < last; ++k) {
    Hit& h = hits_[order_[k]];
    const int a = size_[region_[h.at[0]]], b = size_[region_[h.at[1]]];
    h.inside = a == b ? -1 : a < b ? 0 : 1;
  }
}

// Marks what is reached from a vertex without a way over cut edges, if that is at most `limit` vertices.
void Contours::flood(int seed, int limit) {
  if (region_[seed] >= stamp_) return;
  const int region = int(size_.size()), open = rows_ * cols_ + 1;
  queue_.assign(1, seed), region_[seed] = region;
  bool closed = true;
  const auto visit = [&](int w, int edge) {
    if (w < 0 || w >= rows_ * cols_ || cut_[edge] == stamp_) return;
    if (region_[w] < stamp_)
      region_[w] = region, queue_.push_back(w);
    else if (region_[w] != region && size_[region_[w]] == open)
      closed = false;
  };
  for (std::size_t k = 0; k < queue_.size() && closed; ++k) {
    const int v = queue_[k], r = right(v), l = left(v);
    visit(r, 3 * v), visit(l, 3 * l);
    visit(v + cols_, 3 * v + 1), visit(v - cols_, 3 * (v - cols_) + 1);
    if (r >= 0) visit(r + cols_, 3 * v + 2);
    if (l >= 0) visit(l - cols_, 3 * (l - cols_) + 2);
    closed &= int(queue_.size()) <= limit;
  }
  size_.push_back(closed ? int(queue_.size()) : open);
}

// A contour that ends inside of a sheet, where the other's border passes it, goes on to the nearest border.
void Contours::close(int first, int last) {
  std::vector<int> from;
  for (int k = first; k < last; ++k) {
    cut_[hits_[order_[k]].edge] = 0;
    if (stop_[order_[k]] == -1) from.push_back(hits_[order_[k]].at[2]);
  }
  stamp_ = int(size_.size());  // that of sides() to come
  for (const int v : from) {
    const int r = v / cols_, c = v % cols_;
    const int ways[4] = {r, rows_ - 1 - r, periodic_ ? rows_ : c, periodic_ ? rows_ : cols_ - 1 - c};
    const int way = int(std::min_element(ways, ways + 4) - ways), steps[4] = {-cols_, cols_, -1, 1};
    for (int k = 0; k <= ways[way]; ++k) region_[v + k * steps[way]] = stamp_;
  }
  sides(first, last);
}

// Which cells cross which.
void Contours::mark() {
  cells_.clear(), crossed_.clear(), std::fill(first_.begin(), first_.end(), 0);
  for (const Hit& h : hits_)
    cells_.push_back({h.own / 2, h.triangle / 2}), cells_.push_back({h.triangle / 2, h.own / 2});
  std::sort(cells_.begin(), cells_.end());
  cells_.erase(std::unique(cells_.begin(), cells_.end()), cells_.end());
  for (const auto& pair : cells_) ++first_[pair[0] + 1], crossed_.push_back(pair[1]);
  std::partial_sum(first_.begin(), first_.end(), first_.begin());
}

bool Contours::near(int first, int second) const {
  if (pocket_[first] && pocket_[first] == pocket_[second]) return true;
  const int r = first / cols_, c = first % cols_, r2 = second / cols_, c2 = second % cols_;
  for (int i = std::max(r - 1, 0); i <= std::min(r + 1, rows_ - 1); ++i)
    for (int j = c - 1; j <= c + 1; ++j) {
      if (!periodic_ && (j < 0 || j >= cols_)) continue;
      const int cell = i * cols_ + (j + cols_) % cols_;
      for (int k = first_[cell]; k < first_[cell + 1]; ++k) {
        int dc = std::abs(crossed_[k] % cols_ - c2);
        if (periodic_) dc = std::min(dc, cols_ - dc);
        if (dc <= 1 && std::abs(crossed_[k] / cols_ - r2) <= 1) return true;
      }
    }
  return false;
}

int Contours::neighbours(int v, int (&to)[6]) const {
  const int r = right(v), l = left(v), last = rows_ * cols_ - cols_;
  const bool between = v >= cols_ && v < last;
  int n = 0;
  if (r >= 0 && l >= 0) to[n++] = r, to[n++] = l;
  if (between) to[n++] = v + cols_, to[n++] = v - cols_;
  if (n == 4) to[n++] = r + cols_, to[n++] = l - cols_;
  return n;
}

}  // namespace minicloth
