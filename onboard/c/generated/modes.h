/* Written by python -m onboard.c.generate. Do not edit. */
#ifndef DMRAC_MODES_H
#define DMRAC_MODES_H

#include <stdbool.h>
#include <stdint.h>

#define EVENT_COUNT 23

typedef enum {
    MODE_BOOT = 0,
    MODE_READY = 1,
    MODE_ARMED = 2,
    MODE_TAKE_OFF = 3,
    MODE_FLYING = 4,
    MODE_HOLD = 5,
    MODE_HOLD_LEVEL = 6,
    MODE_LANDING = 7,
    MODE_LANDED = 8,
    MODE_EMERGENCY = 9,
    MODE_TERMINATED = 10
} FlightMode;

typedef enum {
    EVENT_TERMINATE = 0,
    EVENT_IMU_SILENT_LANDED = 1,
    EVENT_IMU_SILENT = 2,
    EVENT_FAULT = 3,
    EVENT_TILTED = 4,
    EVENT_VELOCITY_LOST = 5,
    EVENT_VELOCITY_BACK = 6,
    EVENT_POSITION_LOST = 7,
    EVENT_POSITION_BACK = 8,
    EVENT_GYRO_STUCK = 9,
    EVENT_BATTERY_LOW = 10,
    EVENT_BATTERY_SILENT = 11,
    EVENT_GROUND_SILENT = 12,
    EVENT_OUT_OF_BOUNDS = 13,
    EVENT_TIME_UP = 14,
    EVENT_TOUCHED_DOWN = 15,
    EVENT_AT_HEIGHT = 16,
    EVENT_ARM = 17,
    EVENT_DISARM = 18,
    EVENT_TAKE_OFF = 19,
    EVENT_LAND = 20,
    EVENT_HEALTHY = 21,
    EVENT_UNHEALTHY = 22
} Event;

typedef enum {
    COMMAND_ARM = 0,
    COMMAND_DISARM = 1,
    COMMAND_TAKE_OFF = 2,
    COMMAND_LAND = 3,
    COMMAND_TERMINATE = 4
} Command;

/* Sets of modes: bit `mode` is set for each of them. */
#define MODES_SPINNING (1U << MODE_ARMED | 1U << MODE_TAKE_OFF | 1U << MODE_FLYING | 1U << MODE_HOLD | 1U << MODE_HOLD_LEVEL | 1U << MODE_LANDING)
#define MODES_RESTING (1U << MODE_BOOT | 1U << MODE_READY)
#define MODES_AIRBORNE (1U << MODE_TAKE_OFF | 1U << MODE_FLYING | 1U << MODE_HOLD | 1U << MODE_HOLD_LEVEL | 1U << MODE_LANDING)

/* An event that ends a mode, and the next mode. */
typedef struct {
    Event event;
    FlightMode target;
} Transition;

/* Entry `index` of the row of a mode, the most urgent first; false behind the last one. */
bool transition(FlightMode mode, int32_t index, Transition *out);

#endif
