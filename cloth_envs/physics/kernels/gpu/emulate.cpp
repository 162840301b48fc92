// The frame that a card runs, run here thread by thread: what tests of it compare. LANES names the namespace.
#define LANES emulated
#define MINICLOTH_SCALAR
#include <nanobind/nanobind.h>
#include <nanobind/stl/vector.h>

#include <cmath>
#include <cstdint>
#include <cstring>
#include <vector>

#include "../module.hpp"
#include "frame.hpp"

namespace nb = nanobind;

namespace minicloth {

extern const char* const kCardText;

namespace {

CardSheet sheet_of(const nb::bytes& bytes) {
  CardSheet sheet;
  if (bytes.size() != sizeof sheet) throw nb::value_error("the bytes are not a CardSheet of gpu/terms.hpp");
  std::memcpy(&sheet, bytes.c_str(), sizeof sheet);
  return sheet;
}

template <int kStrip>
void emulate(const CardSheet& s, const CardBatch& batch, int members, bool backwards) {
  std::vector<unsigned char> memory(LANES::Shared::bytes(s));
  const int busy = (s.rows + kStrip - 1) / kStrip * s.cols;
  for (int member = 0; member < members; ++member) {
    const std::size_t numbers = std::size_t(3) * s.rows * s.cols, first = numbers * member;
    // NaN: on a card what threads share, and where a frame's end goes, hold anything at first.
    std::memset(memory.data(), 0xff, memory.size());
    for (float* out : {batch.x_out, batch.v_out}) std::memset(out + first, 0xff, numbers * sizeof(float));
    std::vector<LANES::Own<kStrip>> own((busy + 31) / 32 * 32);  // whole warps
    for (int t = 0; t < int(own.size()); ++t) {
      own[t].number = t, own[t].col = t % s.cols, own[t].row = t / s.cols * kStrip;
      own[t].place = t < busy ? t : busy - 1;
    }
    const LANES::Shared shared(s, memory.data(), batch.x_out + first);
    LANES::Block<kStrip> block{own.data(), int(own.size()), backwards};
    LANES::frame(s, batch, member, shared, block);
  }
}

}  // namespace

void bind_card(nb::module_& m) {
  m.def(
      "card_memory", [](nb::bytes sheet) { return LANES::Shared::bytes(sheet_of(sheet)); }, nb::arg("sheet"),
      "Memory that the threads of a block share to step a CardSheet [bytes].");
  m.def("card_text", [] { return kCardText; }, "What a card compiles, but for what it is told by macros.");
  m.def(
      "emulate_card",
      [](nb::bytes sheet, const std::vector<std::uintptr_t>& fields, int members, int strip, bool backwards) {
        const CardSheet s = sheet_of(sheet);
        CardBatch batch;
        if (fields.size() * sizeof(void*) != sizeof batch)
          throw nb::value_error("the fields are not as many as CardBatch of gpu/terms.hpp has");
        std::memcpy(&batch, fields.data(), sizeof batch);
        nb::gil_scoped_release release;
        if (strip == 1)
          emulate<1>(s, batch, members, backwards);
        else if (strip == 4)
          emulate<4>(s, batch, members, backwards);
        else
          throw nb::value_error("strip must be 1 or 4");
      },
      nb::arg("sheet"), nb::arg("fields"), nb::arg("members"), nb::arg("strip"), nb::arg("backwards"),
      "A frame as a card runs it: a CardSheet, and the addresses that a CardBatch holds. A thread has `strip` "
      "vertices; "
      "the threads take turns, the last first if `backwards`.");
}

}  // namespace minicloth
