"""Generated from wire/proto; do not edit."""
