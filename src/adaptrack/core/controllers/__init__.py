"""Control laws, one file a law; `contract` says what a law is given and what it answers."""
