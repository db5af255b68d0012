// The type of what needs no more than a device's widest numbers have: float32, where there is no float64.
typedef float real;
