/* One face for Embree 3 and 4: the installed headers, plus the four query calls in one form.
 *
 * build.rs defines TWOPASS_EMBREE to the major version it found. Everything else that this crate
 * calls has the same signature in both versions. */
#ifndef TWOPASS_EMBREE_H
#define TWOPASS_EMBREE_H

#if TWOPASS_EMBREE == 4
#include <embree4/rtcore.h>
#elif TWOPASS_EMBREE == 3
#include <embree3/rtcore.h>
#else
#error "TWOPASS_EMBREE must be 3 or 4"
#endif

/* Nearest hit of one ray. */
void twopass_intersect1(RTCScene scene, struct RTCRayHit *rayhit);

/* Whether anything blocks one ray; `tfar` becomes -inf where so. */
void twopass_occluded1(RTCScene scene, struct RTCRay *ray);

/* Nearest hits of the lanes with valid[i] == -1; `valid` and `rayhit` are 64-byte aligned. */
void twopass_intersect16(const int *valid, RTCScene scene, struct RTCRayHit16 *rayhit, int coherent);

/* The same for packets of 4 and 8, aligned to 16 and 32 bytes: to compare rates. */
void twopass_intersect4(const int *valid, RTCScene scene, struct RTCRayHit4 *rayhit, int coherent);
void twopass_intersect8(const int *valid, RTCScene scene, struct RTCRayHit8 *rayhit, int coherent);

/* Occlusion of the lanes with valid[i] == -1; `valid` and `ray` are 64-byte aligned. */
void twopass_occluded16(const int *valid, RTCScene scene, struct RTCRay16 *ray, int coherent);

#endif
