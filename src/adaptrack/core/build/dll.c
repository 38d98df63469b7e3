/* What a DLL for Windows takes of a run-time library, so that zig need not compile one: the beginning of the DLL, and
   the growth of the stack. */
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
