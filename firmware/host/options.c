#include "../sensor/options.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

typedef struct {
    const char *name;
    double value;
    const char *text;
} option;

static const option ALL[] = {
#define ROW(name, value, text) {#name, value, text},
    OPTIONS(ROW)
#undef ROW
};

enum { COUNT = sizeof ALL / sizeof ALL[0] };

static void refuse(const char *argument)
{
    fprintf(stderr, "argument \"%s\" is not KEY=NUMBER with one of these keys:\n", argument);
    for (size_t i = 0; i < COUNT; i++) {
        fprintf(stderr, "  %s=%.10g  %s\n", ALL[i].name, ALL[i].value, ALL[i].text);
    }
    exit(64);
}

static size_t place_of(const char *argument, const char *equals)
{
    for (size_t i = 0; i < COUNT && equals != NULL; i++) {
        size_t length = (size_t)(equals - argument);
        if (strlen(ALL[i].name) == length && strncmp(ALL[i].name, argument, length) == 0) {
            return i;
        }
    }
    refuse(argument);
    return 0;
}

options options_read(int count, char **arguments)
{
    double values[COUNT];
    for (size_t i = 0; i < COUNT; i++) {
        values[i] = ALL[i].value;
    }
    for (int i = 0; i < count; i++) {
        const char *equals = strchr(arguments[i], '=');
        size_t place = place_of(arguments[i], equals);
        char *end;
        values[place] = strtod(equals + 1, &end);
        if (end == equals + 1 || *end != '\0') {
            refuse(arguments[i]);
        }
    }
    options result;
    size_t next = 0;
#define TAKE(name, value, text) result.name = values[next++];
    OPTIONS(TAKE)
#undef TAKE
    return result;
}
