/* printf for Windows, of its own run-time library, so that zig need not compile one. */
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>

int __stdio_common_vsprintf(uint64_t options, char *text, size_t size, const char *format, void *locale, va_list values);
int vsnprintf(char *text, size_t size, const char *format, va_list values);
int vsnprintf(char *text, size_t size, const char *format, va_list values) {
    return __stdio_common_vsprintf(2, text, size, format, 0, values); /* 2: ends the text as C99 says */
}

int snprintf(char *text, size_t size, const char *format, ...);
int snprintf(char *text, size_t size, const char *format, ...) {
    va_list values;
    int length;
    va_start(values, format);
    length = vsnprintf(text, size, format, values);
    va_end(values);
    return length;
}
