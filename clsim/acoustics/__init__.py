"""Published formulae: arrays in, arrays out, one citation each."""
