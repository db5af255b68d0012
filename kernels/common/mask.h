// The activity mask of a block and a path: the first subblock in which it sounds, and the one after the last; 0 for none.

#define MASK(first, end) ((first) | (end) << 16)
#define MASK_FIRST(mask) ((mask) & 0xffff)
#define MASK_END(mask) ((mask) >> 16)
