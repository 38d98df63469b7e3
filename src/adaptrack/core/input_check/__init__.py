"""Which inputs of a loop contradict each other, sample by sample: `record` has what is kept, `call` what is called."""
