// Where a branch signal stands, `ahead` of its own samples after that of the recording's sample: see branches.cl.
#if OVERSAMPLING == 1
#define PLACE(ahead, stride) (ahead)
#elif OVERSAMPLING == 2
#define PLACE(ahead, stride) (((ahead) >> 1) + ((ahead) & 1) * ((stride) / 2))
#endif
