// What a path has besides images, one for each slot: by its kind.

typedef struct {
    double source_turn[9], source_shift[3];  // from the room to what the scatterer sees by the walls before it
    double receiver_turn[9], receiver_shift[3];
    double semi_axes[3];                     // m
    double strength;                         // of a point, m
    int thing, turned, shape;                // in the table of poses; whether its orientation matters; POINT, CAPSULE, SPHERE or else
    int first_mode, modes, least;            // of a sphere: where its table begins, modes there, and how many at least are needed
} scatterer_view;

typedef struct {
    double turn[9], shift[3];  // by the walls at rest before a mirror: from the source's own room to where the mirror is
    double most;               // m/s, up to which its speed is continued beyond its edges
    int face, unused;          // row of the table of poses; -1 for none
} body_view;

#if SCATTERERS
typedef scatterer_view view;
#elif BODIES
typedef struct {
    body_view mirror[BODIES];  // that move, from the source's side
} view;
#else
typedef edge_view view;
#endif
