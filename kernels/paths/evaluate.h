// Validity of a path by walls, of which the ends move. The twin of `evaluate` of specular/intervals.py.

typedef struct {
    room walls;
    end_of_path source, receiver;
    __global const int* sequence;
    double most_slowness;  // 1 / least speed at which sound makes way, s/m
} search;

// Status at an instant, while both ends move as they can for `within` before and after (s); `reach` is how far that is.
static int evaluate(const search* s, double time, double within, double* clear, double* reach)
{
    const triple source_perturbation = SOURCE_PERTURBATION, receiver_perturbation = RECEIVER_PERTURBATION;
    arrivals a;
    locate(&s->receiver.path, time, &a);
    const triple receiver = cubic(a.knot[0], a.u);
    triple image = receiver;
    for (int k = ORDER; k > 0; k--) image = mirrored(s->walls.plane[s->sequence[k - 1]], image);
    listener seen = {{image.x, image.y, image.z}, {0.0, 0.0, 0.0}};
#if WIND
    const triples unseen = {0.0, 0.0, 0.0};  // directions at the receiver are not asked for
    seen.wind = unseen;
    seen.downwind = inner(s->source.path.wind, receiver);
#endif
    a.delay = 0.0;
    solve_delay(&s->source.path, &seen, time, 1e-18, &a);
    const double emitted = time - a.delay;
    locate(&s->source.path, emitted, &a);
    const double slowness = s->most_slowness;
    const double time_dilation = (1.0 + s->receiver.fastest * slowness) / (1.0 - s->source.fastest * slowness);
    const double source_reach =
        within * time_dilation * speed_over(&s->source, emitted - time_dilation * within, emitted + time_dilation * within);
    const double receiver_reach = within * speed_over(&s->receiver, time - within, time + within);
    *reach = fmax(source_reach, receiver_reach);
    return path_status(&s->walls, s->sequence, lifted(&s->source, sum(cubic(a.knot[0], a.u), source_perturbation)),
                       lifted(&s->receiver, sum(receiver, receiver_perturbation)), source_reach, receiver_reach, s->source.mount,
                       s->receiver.mount, clear);
}
