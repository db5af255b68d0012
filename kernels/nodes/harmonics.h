// Real spherical harmonics of a direction, for receivers of CHANNELS ambisonic components: twin of numerics/sphere.py.

#if RECEIVER_DIRECTIVITY == HARMONIC
// Write the components of a direction in the receiver's axes, in ACN order; `norm` is the factor of each. Returns the sum of squares.
static float harmonics(__global const float* norm, float x, float y, float z, float value[CHANNELS])
{
    float cosine = 1.0f, sine = 0.0f, largest = 1.0f, squares = 0.0f;  // of m azimuths, times the sine of the polar angle to the m
    for (int m = 0; m * m < CHANNELS; m++) {
        float before = 0.0f, now = largest;
        for (int l = m; l * l < CHANNELS; l++) {
            const int middle = l * l + l;
            value[middle + m] = norm[middle + m] * now * cosine;
            squares += value[middle + m] * value[middle + m];
            if (m > 0) {
                value[middle - m] = norm[middle - m] * now * sine;
                squares += value[middle - m] * value[middle - m];
            }
            const float next = ((float)(2 * l + 1) * z * now - (float)(l + m) * before) / (float)(l + 1 - m);
            before = now;
            now = next;
        }
        const float turned = cosine * x - sine * y;
        sine = cosine * y + sine * x;
        cosine = turned;
        largest *= (float)(2 * m + 1);
    }
    return squares;
}
#endif
