// Angles at edges, by operators only, which stay within registers and vectors: calls of atan2 took half of the time of a field.

#if VERTEX == EDGE
#define EIGHTH_TAN 0.41421356237309503  // of an eighth of half a turn

// Sines and cosines of four angles side by side, Taylor's of degree 13 and 14 about quarter turns, within 2e-14.
static double4 sines(double4 angle, double4* cosines)
{
    const double4 quarter = (angle * (2.0 / HALF_TURN) + ROUNDING_DOUBLE) - ROUNDING_DOUBLE;
    const double4 f = angle - quarter * (0.5 * HALF_TURN), ff = f * f;
    const double4 s = f * (1.0 + ff * (-1.0 / 6 + ff * (1.0 / 120 + ff * (-1.0 / 5040 + ff * (1.0 / 362880 + ff *
                      (-1.0 / 39916800 + ff * (1.0 / 6227020800.0)))))));
    const double4 c = 1.0 + ff * (-0.5 + ff * (1.0 / 24 + ff * (-1.0 / 720 + ff * (1.0 / 40320 + ff * (-1.0 / 3628800 +
                      ff * (1.0 / 479001600 - ff * (1.0 / 87178291200.0)))))));
    const double4 of_half = 0.5 * quarter, odd = of_half - ((of_half + ROUNDING_DOUBLE) - ROUNDING_DOUBLE);
    const double4 of_turn = quarter - 4.0 * ((0.25 * quarter + ROUNDING_DOUBLE) - ROUNDING_DOUBLE);  // -2 to 2
    const double4 sine = odd != 0.0 ? c : s, cosine = odd != 0.0 ? s : c;
    *cosines = ((of_turn > 0.5) | (of_turn < -1.5)) ? -cosine : cosine;
    return ((of_turn < -0.5) | (of_turn > 1.5)) ? -sine : sine;
}

// Angles of two places (x, y) from the x axis, -1/2 to 1/2 turn; x and y not both 0. Beyond an eighth of half a turn the angle from the
// diagonal is taken; the polynomial interpolates between Chebyshev's nodes, within 2e-15.
static double2 angles_of(double2 y, double2 x)
{
    const double2 high = y < 0.0 ? -y : y, wide = x < 0.0 ? -x : x;
    const double2 small = high < wide ? high : wide, large = high < wide ? wide : high;
    const long2 steep = small > EIGHTH_TAN * large;
    const double2 tangent = (steep ? small - large : small) / (steep ? small + large : large), tt = tangent * tangent;
    const double2 within = tangent * (1.0000000000000002 + tt * (-0.33333333333294668 + tt * (0.1999999998647968 + tt *
                        (-0.14285713018650445 + tt * (0.11111056873805933 + tt * (-0.090896307826116796 + tt *
                        (0.076742611069261293 + tt * (-0.065088541365393354 + tt * (0.050301557886240328 + tt *
                        (-0.025345761550124298))))))))));
    const double2 of_eighth = steep ? within + 0.25 * HALF_TURN : within;
    const double2 of_quarter = high > wide ? 0.5 * HALF_TURN - of_eighth : of_eighth;
    const double2 of_half = x < 0.0 ? HALF_TURN - of_quarter : of_quarter;
    return y < 0.0 ? -of_half : of_half;
}

// The angle with a tangent from 0 to 1, within 1e-7.
static float arc_tangent(float tangent)
{
    const float tt = tangent * tangent;
    return tangent * (1.0f + tt * (-0.333332777f + tt * (0.199980751f + tt * (-0.142600164f + tt * (0.109323412f + tt *
                        (-0.0834972486f + tt * (0.057089556f + tt * (-0.030351866f + tt * (0.0104876496f + tt *
                        (-0.00170117011f))))))))));
}
#endif
