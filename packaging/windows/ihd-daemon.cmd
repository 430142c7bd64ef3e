@echo off
rem The daemon of this user by Task Scheduler. Its folder, with ihd.toml and the store: %LOCALAPPDATA%\ihd.
rem on: it runs whenever the user is logged on; off: no longer. The installer calls pause and resume, the task run.
setlocal
set "folder=%LOCALAPPDATA%\ihd"
set "mark=%folder%\daemon-is-on"
if "%~1"=="on" goto on
if "%~1"=="off" goto off
if "%~1"=="pause" goto pause
if "%~1"=="resume" goto resume
if "%~1"=="run" goto run
echo usage: ihd-daemon on ^| off 1>&2
exit /b 2

:on
if not exist "%LOCALAPPDATA%\Programs\ihd\ihd-daemon.cmd" (
    echo ihd-daemon: the task starts what the installer ^(.msi^) brings: install that first 1>&2
    exit /b 1
)
if not exist "%folder%" mkdir "%folder%"
schtasks /Create /F /TN ihd /XML "%~dp0ihd-task.xml"
if errorlevel 1 exit /b 1
type nul > "%mark%"
echo the daemon starts within a minute, in %folder%
exit /b 0

:off
if exist "%mark%" del "%mark%"

:pause
schtasks /End /TN ihd >nul 2>&1
schtasks /Delete /F /TN ihd >nul 2>&1
exit /b 0

:resume
if exist "%mark%" schtasks /Create /F /TN ihd /XML "%~dp0ihd-task.xml"
exit /b 0

:run
if not exist "%folder%" exit /b 1
cd /d "%folder%"
"%~dp0ihd.exe" trainer --daemon
exit /b %ERRORLEVEL%
