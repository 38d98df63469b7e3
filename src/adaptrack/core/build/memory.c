/* What a compiler may call where it copies a large record, for libraries that call nothing of the system's. */
#include <stddef.h>

__attribute__((visibility("hidden"))) void *memcpy(void *restrict to, const void *restrict from, size_t count) {
    for (size_t i = 0; i < count; i++) ((char *)to)[i] = ((const char *)from)[i];
    return to;
}

__attribute__((visibility("hidden"))) void *memset(void *to, int value, size_t count) {
    for (size_t i = 0; i < count; i++) ((char *)to)[i] = (char)value;
    return to;
}

#ifdef _WIN32
/* The beginning of a DLL, and the growth of the stack: touch each page of rax bytes below it; all registers stay. */
int DllMainCRTStartup(void *dll, unsigned long reason, void *reserved);
int DllMainCRTStartup(void *dll, unsigned long reason, void *reserved) {
    (void)dll, (void)reason, (void)reserved;
    return 1;
}
__asm__(".globl ___chkstk_ms\n"
        "___chkstk_ms:\n"
        "    pushq %rcx\n    pushq %rax\n    leaq 24(%rsp), %rcx\n"
        "1:  cmpq $0x1000, %rax\n    jb 2f\n"
        "    subq $0x1000, %rcx\n    orl $0, (%rcx)\n    subq $0x1000, %rax\n    jmp 1b\n"
        "2:  subq %rax, %rcx\n    orl $0, (%rcx)\n    popq %rax\n    popq %rcx\n    ret\n");
int _fltused = 0; /* the linker looks for it where floats are used */
#endif
