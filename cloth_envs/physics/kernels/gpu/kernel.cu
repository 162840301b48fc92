// The entry that a card runs: one block a cloth. The sheet is known when this is compiled.
extern "C" __global__ void __launch_bounds__(MINICLOTH_THREADS, MINICLOTH_BLOCKS)
    minicloth_frame(const minicloth::CardCloth* cloths, const minicloth::CardBody* bodies, const float* x,
                    const float* v, float* x_out, float* v_out, const float* body_x, const float* body_v,
                    const double* body_x_end, const double* body_v_end, const double* handle_x, const double* handle_v,
                    const double* wind, const double* pressure, const int* handle_of, const int* handles,
                    const int* lead, const double* hold, float* health, int* taken) {
  using namespace minicloth;
  constexpr CardSheet sheet = MINICLOTH_SHEET;
  const CardBatch batch = {cloths,    bodies,     x,          v,        x_out,    v_out, body_x,
                           body_v,    body_x_end, body_v_end, handle_x, handle_v, wind,  pressure,
                           handle_of, handles,    lead,       hold,     health,   taken};
  extern __shared__ __align__(16) unsigned char memory[];
  const LANES::Shared shared(sheet, memory, x_out + std::size_t(3) * sheet.rows * sheet.cols * blockIdx.x);
  LANES::Own<MINICLOTH_STRIP> own;
  own.number = threadIdx.x;
  own.col = own.number % sheet.cols, own.row = own.number / sheet.cols * MINICLOTH_STRIP;
  constexpr int busy = ((sheet.rows - 1) / MINICLOTH_STRIP + 1) * sheet.cols;
  own.place = own.number < busy ? own.number : busy - 1;
  LANES::Block<MINICLOTH_STRIP> block{own, int(blockDim.x)};
  LANES::frame(sheet, batch, int(blockIdx.x), shared, block);
}
