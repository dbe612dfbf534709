#include "protocol/feature_codec.h"

#include <string.h>

#include "numerics/elementary.h"
#include "protocol/little_endian.h"
#include "protocol/msgpack_items.h"

/* Format, size of a parameter, version, parent, samples. */
#define NUMBERS 5
#define CHANNEL_FIELDS 5

/* The fields of a channel in the bytes. */
typedef struct {
    MsgpackItem input_list;
    MsgpackReader inputs; /* at the first one */
    MsgpackItem offset;
    MsgpackItem scale;
    MsgpackItem width_list;
    MsgpackReader widths; /* at the first one */
    MsgpackItem parameters;
} ChannelFields;

/* What of a channel is small enough to be read before all is checked. */
typedef struct {
    FeatureSelection selection;
    int32_t layers;
    int32_t width[LAYERS_MAX];
} ChannelShape;

/* IEEE 754 binary16 */
static real read_f16(const uint8_t *bytes) {
    uint32_t bits = (uint32_t)bytes[0] | (uint32_t)bytes[1] << 8;
    uint32_t sign = bits >> 15, exponent = bits >> 10 & 31, fraction = bits & 1023;
    if (exponent == 0) {
        real value = (real)fraction * REAL(5.9604644775390625e-08);
        return sign ? -value : value;
    }
    uint32_t single = sign << 31 | (exponent == 31 ? 255 : exponent + 112) << 23 | fraction << 13;
    float value;
    memcpy(&value, &single, sizeof value);
    return (real)value;
}

static real read_float(const uint8_t *bytes, size_t index, uint64_t float_size) {
    return float_size == 2 ? read_f16(bytes + 2 * index) : (real)read_f32(bytes + 4 * index);
}

/* The exponent of a number that is not finite is all ones. */
static bool all_finite(const MsgpackItem *floats, uint64_t float_size) {
    uint32_t highest = float_size == 2 ? 0x7c : 0x7f, below = float_size == 2 ? 0 : 0x80;
    for (size_t last = (size_t)float_size - 1; last < floats->number; last += (size_t)float_size) {
        const uint8_t *bytes = floats->bytes + last;
        if ((bytes[0] & highest) == highest && (bytes[-1] & below) == below) {
            return false;
        }
    }
    return true;
}

/* The index of a signal by its name; -1 for an unknown one. */
static int32_t signal_index(const MsgpackItem *name) {
    static const char names[SIGNAL_COUNT][NAME_MAX_BYTES + 1] = {SIGNAL_NAMES};
    for (int32_t i = 0; name->kind == MSGPACK_TEXT && i < SIGNAL_COUNT; i++) {
        if (memcmp(names[i], name->bytes, (size_t)name->number) == 0 && names[i][name->number] == '\0') {
            return i;
        }
    }
    return -1;
}

/* The next item, with a reader at what is within it; false if it is of another kind. */
static bool field(MsgpackReader *reader, MsgpackKind kind, MsgpackItem *item, MsgpackReader *within) {
    msgpack_next(reader, item);
    *within = *reader;
    msgpack_skip(reader, item->kind == MSGPACK_ARRAY ? item->number : 0);
    return item->kind == kind;
}

/* The fields of a channel, of the right kinds. */
static bool split_channel(MsgpackReader *reader, ChannelFields *fields) {
    MsgpackReader unused;
    return field(reader, MSGPACK_ARRAY, &fields->input_list, &fields->inputs) &&
           field(reader, MSGPACK_BYTES, &fields->offset, &unused) &&
           field(reader, MSGPACK_BYTES, &fields->scale, &unused) &&
           field(reader, MSGPACK_ARRAY, &fields->width_list, &fields->widths) &&
           field(reader, MSGPACK_BYTES, &fields->parameters, &unused);
}

/* input_indices: REFUSAL_INPUTS for an unknown name; `twice` if a name occurs twice. */
static Refusal read_inputs(ChannelFields *fields, int32_t index[INPUTS_MAX], bool *twice) {
    bool seen[SIGNAL_COUNT] = {false};
    *twice = false;
    for (uint64_t i = 0; i < fields->input_list.number; i++) {
        MsgpackItem name;
        msgpack_next(&fields->inputs, &name);
        index[i] = signal_index(&name);
        if (index[i] < 0) {
            return REFUSAL_INPUTS;
        }
        *twice = *twice || seen[index[i]];
        seen[index[i]] = true;
    }
    return REFUSAL_NONE;
}

/* _shapes: returns the number of parameters, theta included; 0 if the widths are not allowed, or do not fit into
 * PARAMETERS_MAX. */
static uint64_t read_widths(ChannelFields *fields, ChannelShape *shape) {
    uint64_t layers = fields->width_list.number, below = fields->input_list.number, inner = 0;
    if (layers < 1 || layers > LAYERS_MAX || below < 1) {
        return 0;
    }
    for (uint64_t l = 0; l < layers; l++) {
        MsgpackItem width;
        msgpack_next(&fields->widths, &width);
        if (width.kind != MSGPACK_INTEGER || width.negative || width.number < 1 || width.number > WIDTH_MAX) {
            return 0;
        }
        shape->width[l] = (int32_t)width.number;
        inner += width.number * (below + 1);
        below = width.number;
    }
    shape->layers = (int32_t)layers;
    return inner <= PARAMETERS_MAX ? inner + 3 * (below + 1) : 0;
}

/* Offset and scale; false if a scale is not positive. */
static bool read_scales(const ChannelFields *fields, FeatureSelection *selection) {
    bool positive = true;
    selection->count = (int32_t)fields->input_list.number;
    for (int32_t i = 0; i < selection->count; i++) {
        selection->offset[i] = (real)read_f32(fields->offset.bytes + 4 * i);
        selection->scale[i] = (real)read_f32(fields->scale.bytes + 4 * i);
        positive = positive && selection->scale[i] > REAL(0.0);
    }
    return positive;
}

/* Parameters W_1 (row by row), b_1, ..., last_layer into the channel, which has b behind each row of W. */
static void take_parameters(ChannelFeatures *channel, const uint8_t *bytes, uint64_t float_size) {
    Network *network = &channel->network;
    size_t from = 0, inputs = (size_t)channel->selection.count;
    real *layer = network->parameters;
    for (int32_t l = 0; l < network->layers; l++) {
        size_t width = (size_t)network->width[l];
        for (size_t row = 0; row < width; row++) {
            for (size_t column = 0; column < inputs; column++) {
                layer[row * (inputs + 1) + column] = read_float(bytes, from++, float_size);
            }
        }
        for (size_t row = 0; row < width; row++) {
            layer[row * (inputs + 1) + inputs] = read_float(bytes, from++, float_size);
        }
        layer += width * (inputs + 1);
        inputs = width;
    }
    for (size_t i = 0; i < 3 * (inputs + 1); i++) {
        channel->last_layer[i] = read_float(bytes, from++, float_size);
    }
}

/* Fill a channel whose bytes have been checked. */
static void take_channel(ChannelFeatures *out, const ChannelShape *shape, const uint8_t *parameters,
                         uint64_t float_size) {
    out->selection = shape->selection;
    out->network.layers = shape->layers;
    memcpy(out->network.width, shape->width, sizeof shape->width);
    take_parameters(out, parameters, float_size);
}

/* _unpack_channel, and the checks of ChannelFeatures. `out` NULL: only check. */
static Refusal unpack_channel(MsgpackReader *reader, uint64_t float_size, bool *covered, ChannelFeatures *out) {
    ChannelFields fields;
    ChannelShape shape;
    MsgpackItem item;
    bool twice;
    msgpack_next(reader, &item);
    *covered = item.kind != MSGPACK_NIL;
    if (!*covered) {
        return REFUSAL_NONE;
    }
    if (item.kind != MSGPACK_ARRAY || item.number != CHANNEL_FIELDS || !split_channel(reader, &fields)) {
        return REFUSAL_UNDECODABLE;
    }
    if (read_inputs(&fields, shape.selection.index, &twice) != REFUSAL_NONE) {
        return REFUSAL_INPUTS;
    }
    uint64_t count = read_widths(&fields, &shape), vector_bytes = 4 * fields.input_list.number;
    if (count == 0 || fields.parameters.number != float_size * count || fields.offset.number != vector_bytes ||
        fields.scale.number != vector_bytes) {
        return REFUSAL_UNDECODABLE;
    }
    if (out == NULL && (!all_finite(&fields.parameters, float_size) || !all_finite(&fields.offset, 4) ||
                        !all_finite(&fields.scale, 4))) {
        return REFUSAL_NOT_FINITE;
    }
    if (!read_scales(&fields, &shape.selection) || twice) {
        return REFUSAL_UNDECODABLE;
    }
    if (out != NULL) {
        take_channel(out, &shape, fields.parameters.bytes, float_size);
    }
    return REFUSAL_NONE;
}

/* Check all (`out` NULL), or read what has been checked. */
static Refusal unpack(const uint8_t *data, size_t size, int64_t version, FeatureSet *out) {
    MsgpackReader reader;
    MsgpackItem all, number[NUMBERS];
    msgpack_start(&reader, data, size, SIGNAL_COUNT, NAME_MAX_BYTES);
    if (!msgpack_is_one_item(&reader)) {
        return REFUSAL_UNDECODABLE;
    }
    msgpack_next(&reader, &all);
    bool good = all.kind == MSGPACK_ARRAY && all.number == NUMBERS + 2;
    for (int i = 0; good && i < NUMBERS; i++) {
        msgpack_next(&reader, number + i);
        good = number[i].kind == MSGPACK_INTEGER;
    }
    if (!good || number[0].negative || number[0].number != FEATURE_SET_FORMAT || number[1].negative ||
        (number[1].number != 2 && number[1].number != 4)) {
        return REFUSAL_UNDECODABLE;
    }
    bool covers[2];
    for (int i = 0; i < 2; i++) {
        Refusal refusal = unpack_channel(&reader, number[1].number, covers + i, out ? out->channels + i : NULL);
        if (refusal != REFUSAL_NONE) {
            return refusal;
        }
    }
    if (number[2].negative || number[3].negative || number[4].negative || number[2].number != (uint64_t)version ||
        number[3].number > UINT32_MAX || !(covers[0] || covers[1])) {
        return REFUSAL_UNDECODABLE;
    }
    if (out != NULL) {
        out->version = (int64_t)number[2].number;
        out->parent = (int64_t)number[3].number;
        out->samples = number[4].number < INT64_MAX ? (int64_t)number[4].number : INT64_MAX;
        memcpy(out->covers, covers, sizeof covers);
    }
    return REFUSAL_NONE;
}

/* decode_feature_set, and FeatureReceiver._verified */
Refusal decode_feature_set(const uint8_t *data, size_t size, int64_t version, FeatureSet *out) {
    Refusal refusal = unpack(data, size, version, NULL);
    return refusal == REFUSAL_NONE ? unpack(data, size, version, out) : refusal;
}
