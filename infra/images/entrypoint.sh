#!/bin/sh
# Reads secrets from files: for each variable NAME_FILE of farfield, PostgreSQL and AWS, NAME becomes what the file holds.
set -eu
for name in $(env | sed -n 's/^\(\(FARFIELD\|PG\|AWS\)[A-Z0-9_]*\)_FILE=.*/\1/p'); do
    eval "path=\$${name}_FILE"
    case $name in AWS_SHARED_CREDENTIALS | AWS_CONFIG | AWS_WEB_IDENTITY_TOKEN) continue ;; esac # boto3 reads these itself
    if [ ! -r "$path" ]; then
        echo "${name}_FILE names $path, which cannot be read" >&2
        exit 1
    fi
    export "$name=$(cat "$path")"
    unset "${name}_FILE"
done
exec "$@"
