/* The library in the firmware: start-up, sockets, files and the three modes around the autopilot. */
#ifndef DMRAC_MAMBO_LIBRARY_H
#define DMRAC_MAMBO_LIBRARY_H

#include "autopilot.h"
#include "bench.h"
#include "flow_queue.h"
#include "ground.h"
#include "recorder.h"
#include "udp.h"
#include "view.h"

/* Folder of configuration, session number, log and record; the environment variable of this name changes it. */
#define FOLDER_VARIABLE "DMRAC_FOLDER"
#ifndef DMRAC_FOLDER
#define DMRAC_FOLDER "/data/edu"
#endif
#define IMAGE_FILE "dmrac.bin"
#define SESSION_FILE "dmrac.session"
#define RECORD_FILE "dmrac.rec"
#define LOG_FILE "dmrac.log"

typedef enum { LIBRARY_NEW, LIBRARY_REFUSED, LIBRARY_RUNS } LibraryState;

typedef struct {
    LibraryState state;
    BoardMode mode;
    int64_t calls;
    uint8_t bytes[IMAGE_BYTES_MAX]; /* of the image */
    Image image;
    ImageFault fault;
    Autopilot autopilot;
    Bench bench;
    Recorder recorder;
    FlowQueue flows;
    UdpSocket offboard;
    GroundLink ground;
    UdpSocket ground_socket;
    int64_t recorded_events;
    uint64_t session;
} Library;

/* Load the image and open everything; `state` says whether it runs, `fault` why not. */
void library_start(Library *self, int64_t now_ns);

/* A call of the firmware. */
void library_control(Library *self, const uint8_t *acquisition, HalCommand *command);

/* What the library did in the last call. */
void library_view(const Library *self, DmracView *out);

#endif
