"""What lets a network drive: the online check, the supervisor, the certificate."""
