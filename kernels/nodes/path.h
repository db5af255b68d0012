// What a path has besides images, one structure for each slot: by its leg (LEG: STATIC or MOVING, of at most MIRRORS mirrors that
// move) and its vertex (VERTEX: NONE, EDGE, SCATTERER or SHADE).

#define TWO_SIDED (VERTEX == EDGE || VERTEX == SCATTERER)  // both ends are seen from the vertex, on static legs

// Numbers of a launch, as its arguments of these names; those of `run` are explained in tracks.cl.
typedef struct {
    double first_knot, knot_rate, first_pose, pose_rate, start, speed_of_sound, wind[3];
    int knot_count, pose_count;
} motion_numbers;

typedef struct {
    double sampling_rate, delay_samples, emitted_first, emitted_last, origin, max_rate, middle;
    float angular_frequency, smooth;
    int first_segment, oversampling;
    float subblock_share;
    int function_count, angular, nodes, blocks, block_samples, segment_blocks, subblock_samples, cells;
} run_numbers;

typedef struct {
    double source_turn[9], source_shift[3];      // from the room to across, out and along the edge, seen by the walls between
    double receiver_turn[9], receiver_shift[3];
    double n;                                    // exterior angle over half a turn
    double low[2];                               // where angles of source and receiver begin
    double wide[2], narrow[2];                   // sine and cosine of n half turns, and of a quarter turn over n
    double even[2], odd[2];                      // the same of n half turns for every two reflections of a term's partner
    double end;                                  // m along the edge, where `end_side` is not 0
    double moment[2], span[2];                   // from where and to where it fades, and for how long, s: 0 without fades
    double slip[2];                              // of fades, by how much the path is longer, s/m
    int lit[4];                                  // of its terms: 1 or -1, 0 for those that are left out
    int end_side;                                // of the end that the path runs over; 0 for one over the edge itself
    int face[2];                                 // tables of the 0-face and the n-face; -1 for the same at every angle
    int bounces[2];                              // reflections of partners: of the first two terms, and of the others
    float corner;                                // angle at which the path comes to the corner itself, see `end_transition`
    float share[2][2];                           // real and imaginary parts of what fades at either time
} edge_view;

typedef struct {
    double source_turn[9], source_shift[3];  // from the room to what the scatterer sees by the walls before it
    double receiver_turn[9], receiver_shift[3];
    double semi_axes[3];                     // m
    double strength;                         // of a point, m; of what has an outline the central waves in a metre
    int thing, turned, shape;                // in the table of poses; whether its orientation matters; POINT, CAPSULE, SPHERE or else
    int first_mode, modes, least;            // where its table begins; modes of a sphere or points of an outline, 0 without; fewest modes
} scatterer_view;

typedef struct {
    double turn[9], shift[3];  // by the walls at rest before a mirror: from the source's own room to where the mirror is
    double most;               // m/s, up to which its speed is continued beyond its edges
    int face, unused;          // row of the table of poses; -1 for none
} mirror_view;

typedef struct {
    int first, count;  // parts of a path between walls, in the table of shade.h
} shade_view;

#if VERTEX == SCATTERER
typedef scatterer_view view;
#elif VERTEX == SHADE
typedef shade_view view;
#elif LEG == MOVING
typedef struct {
    mirror_view mirror[MIRRORS];  // that move, from the source's side
} view;
#else
typedef edge_view view;
#endif

#if VERTEX == SCATTERER
#define STATE_NUMBERS 6
#elif LEG == MOVING
#define STATE_NUMBERS (4 * MIRRORS)
#else
#define STATE_NUMBERS 0
#endif

// The state of a path that is solved together with its delay: how it begins, the STATE_NUMBERS numbers that are written of it at the
// ends of segments, and its prediction between these. Static legs without a scatterer have none.
#if STATE_NUMBERS == 0
typedef int path_state;
static void begin_state(triples ear, path_state* b) {}
static void write_state(const path_state* b, int node, __global double* told, int slots) {}
static void predict_state(__global const double* coarse, long slots, double segment_time, double* expected) {}
static void expected_state(const double* expected, reals u, path_state* b) {}
#endif

#if LEG == STATIC && !TWO_SIDED
#define SOLVE_DELAY(path, poses, seen, receiver, time, small, a, b) solve_delay(path, receiver, time, small, a)
#define SOLVE_ANEW SOLVE_DELAY
#endif
