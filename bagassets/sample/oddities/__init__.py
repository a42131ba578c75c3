"""What real recordings do and the sample car does not: each oddity changes the messages of a drive."""
