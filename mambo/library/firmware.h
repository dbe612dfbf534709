/* The firmware's side of the library: what it calls, and the structures that it hands over. Written from public facts
 * about the Mambo; docs/real_mambo.md lists which of them only hardware can confirm.
 *
 * The acquisition is read by offsets that the configuration image gives, so that a firmware with another layout needs
 * no new library. It has ACQUISITION_BYTES. */
#ifndef DMRAC_FIRMWARE_H
#define DMRAC_FIRMWARE_H

#include <stdint.h>

#define ACQUISITION_BYTES 2432
/* Samples of 1 kHz in a call. */
#define FIFO_SAMPLES 5

typedef enum { MOTORS_NONE = 0, MOTORS_START = 1, MOTORS_STOP = 2, MOTORS_RUN = 3 } MotorWord;

/* Turns the ultrasonic sensor on. */
#define ULTRASOUND_START 16

/* What the library writes. On the drone, pointers have 4 bytes: motors_speed stands at byte 4, ultrasound_command
 * at 12. */
typedef struct {
    int32_t command;       /* a MotorWord */
    int16_t *motors_speed; /* [4], motors 1 to 4 of the firmware; its memory is the firmware's */
    uint8_t enable_security;
    int32_t ultrasound_command;
} HalCommand;

#define EXPORTED __attribute__((visibility("default")))

/* At 200 Hz, in a thread of real-time priority. */
EXPORTED void RSEDU_control(const void *acquisition, HalCommand *command);
/* At about 60 Hz, in another thread: velocity over ground, m/s, in the firmware's axes. */
EXPORTED void RSEDU_optical_flow(float vx, float vy, float vz, int defined, float quality);
/* At about 60 Hz, in another thread. */
EXPORTED void RSEDU_image_processing(const void *image);

#endif
