// Gains at a node of a path: its arrival, as its leg and vertex have it, and the response of that.

#if LEG == STATIC && !TWO_SIDED
static arrival arrival_of(const path_nodes* s, int i, double through, const environment* env, response* field, int* fielded)
{
    const arrivals* a = s->node + VECTOR(i);
    const int lane = LANE(i);
#if VERTEX == SHADE && PARTS == 2
    shade_at(s, i, field);
    *fielded = 1;
#else
    *fielded = 0;
#endif
    const triple departure = triple_of(&a->departure, lane);
#if WIND
    const arrival here = {(float)through, (float)OF_NODE(a->length, lane), OF_NODE(a->mach_factor, lane), departure,
                          triple_of(&a->arrival, lane), a->knot[lane], OF_NODE(a->u, lane)};
#else
    const arrival here = {(float)through, (float)through, OF_NODE(a->mach_factor, lane), departure, departure,
                          a->knot[lane], OF_NODE(a->u, lane)};
#endif
    return here;
}
#endif

// The gains at a node of the group; a receiver of several channels has a row of `channel_gains` for each of them.
static float gains_of_node(const path_nodes* s, int i, double speed_of_sound, const environment* env, gains* gain,
                           float* residual)
{
    response field, shared;
    int fielded;
    const arrival here = arrival_of(s, i, OF_NODE(s->node[VECTOR(i)].delay, LANE(i)) * speed_of_sound, env, &field, &fielded);
    triple frame[3];
#if RECEIVER_DIRECTIVITY != OMNI
    for (int k = 0; k < 3; k++) frame[k] = triple_of(RECEIVER_AT(s, i).frame + k, LANE(i));
#endif
    shared_response(&here, env, LEG == MOVING ? 0 : env->angular, s->slots, s->slot, &shared);
#if VERTEX == SHADE  // errors count beside the path in the shadow
    environment none = *env;
    float whole;
    none.function_count = 0;
    const float beside = mean_squares(&shared, &none, 0, &whole);
#else
    const float beside = 0.0f;
#endif
    return channel_gains(&shared, &here, env, frame, fielded ? &field : 0, gain, residual) + beside;
}

// What no function represents of a path active from sample `from` to `until`, at nodes up to `near` from a sample. Nodes of paths
// over edges where these are not active may lie beyond a boundary, and the functions are not made for such: they do not count.
static float residual_where_active(float largest_residual, int sample, int near, int from, int until)
{
#if VERTEX == EDGE
    if (from > sample - near || until < sample + near) return 0.0f;
#endif
    return largest_residual;
}
