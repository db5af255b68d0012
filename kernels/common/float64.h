// The type of what needs no more than a device's widest numbers have: float64.
typedef double real;
