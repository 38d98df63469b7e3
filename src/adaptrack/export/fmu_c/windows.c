/* What a DLL for Windows takes of a run-time library, so that zig need not compile one: the beginning of the DLL, the
   growth of the stack, and printf. */
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>

int DllMainCRTStartup(void *dll, unsigned long reason, void *reserved);
int DllMainCRTStartup(void *dll, unsigned long reason, void *reserved) {
    (void)dll, (void)reason, (void)reserved;
    return 1;
}

/* Touch each page of rax bytes below the stack; all registers stay. */
__asm__(".globl ___chkstk_ms\n"
        "___chkstk_ms:\n"
        "    pushq %rcx\n    pushq %rax\n    leaq 24(%rsp), %rcx\n"
        "1:  cmpq $0x1000, %rax\n    jb 2f\n"
        "    subq $0x1000, %rcx\n    orl $0, (%rcx)\n    subq $0x1000, %rax\n    jmp 1b\n"
        "2:  subq %rax, %rcx\n    orl $0, (%rcx)\n    popq %rax\n    popq %rcx\n    ret\n");

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
