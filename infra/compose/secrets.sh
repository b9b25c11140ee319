#!/bin/sh
# Writes random secrets for docker-compose.yml into secrets/, once: what is there stays. Nothing has a default password.
set -eu
folder=${1:-secrets}
umask 077
mkdir -p "$folder"
random() { od -An -N"${1:-24}" -tx1 /dev/urandom | tr -d ' \n'; }
put() { # NAME VALUE: readable for the containers' users, in a folder that only its owner opens
    [ -s "$folder/$1" ] || { printf '%s' "$2" >"$folder/$1" && chmod 444 "$folder/$1"; }
}
put postgres_password "$(random)"
put broker_password "$(random)"
put s3_access_key "farfield$(random 4)"
put s3_secret_key "$(random)"
put session_secret "$(random 32)"
put webhook_key "$(random 32)"
put database_url "postgresql://farfield:$(cat "$folder/postgres_password")@postgres:5432/farfield"
put broker_url "redis://:$(cat "$folder/broker_password")@broker:6379/0"
put rate_store "redis://:$(cat "$folder/broker_password")@broker:6379/1"
echo "secrets are in $folder/"
