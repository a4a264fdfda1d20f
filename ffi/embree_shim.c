#include "embree.h"

/* Embree 3 takes a context that it may write to, Embree 4 optional arguments: both live on the
 * caller's stack, so that threads share nothing. */
#if TWOPASS_EMBREE == 4
typedef struct RTCIntersectArguments IntersectSettings;
typedef struct RTCOccludedArguments OccludedSettings;
#define INIT_INTERSECT(s) rtcInitIntersectArguments(s)
#define INIT_OCCLUDED(s) rtcInitOccludedArguments(s)
#define COHERENT RTC_RAY_QUERY_FLAG_COHERENT
#define INTERSECT1(scene, s, rayhit) rtcIntersect1(scene, rayhit, s)
#define OCCLUDED1(scene, s, ray) rtcOccluded1(scene, ray, s)
#define INTERSECT4(valid, scene, s, rayhit) rtcIntersect4(valid, scene, rayhit, s)
#define INTERSECT8(valid, scene, s, rayhit) rtcIntersect8(valid, scene, rayhit, s)
#define INTERSECT16(valid, scene, s, rayhit) rtcIntersect16(valid, scene, rayhit, s)
#define OCCLUDED16(valid, scene, s, ray) rtcOccluded16(valid, scene, ray, s)
#else
typedef struct RTCIntersectContext IntersectSettings;
typedef struct RTCIntersectContext OccludedSettings;
#define INIT_INTERSECT(s) rtcInitIntersectContext(s)
#define INIT_OCCLUDED(s) rtcInitIntersectContext(s)
#define COHERENT RTC_INTERSECT_CONTEXT_FLAG_COHERENT
#define INTERSECT1(scene, s, rayhit) rtcIntersect1(scene, s, rayhit)
#define OCCLUDED1(scene, s, ray) rtcOccluded1(scene, s, ray)
#define INTERSECT4(valid, scene, s, rayhit) rtcIntersect4(valid, scene, s, rayhit)
#define INTERSECT8(valid, scene, s, rayhit) rtcIntersect8(valid, scene, s, rayhit)
#define INTERSECT16(valid, scene, s, rayhit) rtcIntersect16(valid, scene, s, rayhit)
#define OCCLUDED16(valid, scene, s, ray) rtcOccluded16(valid, scene, s, ray)
#endif

void twopass_intersect1(RTCScene scene, struct RTCRayHit *rayhit) {
    IntersectSettings settings;
    INIT_INTERSECT(&settings);
    INTERSECT1(scene, &settings, rayhit);
}

void twopass_occluded1(RTCScene scene, struct RTCRay *ray) {
    OccludedSettings settings;
    INIT_OCCLUDED(&settings);
    OCCLUDED1(scene, &settings, ray);
}

void twopass_intersect4(const int *valid, RTCScene scene, struct RTCRayHit4 *rayhit, int coherent) {
    IntersectSettings settings;
    INIT_INTERSECT(&settings);
    if (coherent) settings.flags = COHERENT;
    INTERSECT4(valid, scene, &settings, rayhit);
}

void twopass_intersect8(const int *valid, RTCScene scene, struct RTCRayHit8 *rayhit, int coherent) {
    IntersectSettings settings;
    INIT_INTERSECT(&settings);
    if (coherent) settings.flags = COHERENT;
    INTERSECT8(valid, scene, &settings, rayhit);
}

void twopass_intersect16(const int *valid, RTCScene scene, struct RTCRayHit16 *rayhit, int coherent) {
    IntersectSettings settings;
    INIT_INTERSECT(&settings);
    if (coherent) settings.flags = COHERENT;
    INTERSECT16(valid, scene, &settings, rayhit);
}

void twopass_occluded16(const int *valid, RTCScene scene, struct RTCRay16 *ray, int coherent) {
    OccludedSettings settings;
    INIT_OCCLUDED(&settings);
    if (coherent) settings.flags = COHERENT;
    OCCLUDED16(valid, scene, &settings, ray);
}
