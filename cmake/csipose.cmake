# Flags for all our targets, and the two functions that make tests and fuzz targets.

add_library(csipose_flags INTERFACE)
target_compile_options(csipose_flags INTERFACE -Wall -Wextra -Wpedantic -Wshadow -Wconversion -Wno-sign-conversion -Werror
                       -fno-math-errno -ffp-contract=off)
if(CMAKE_CXX_COMPILER_ID STREQUAL GNU AND CMAKE_CXX_COMPILER_VERSION VERSION_LESS 13)
  # GCC 12 sees overlapping and over-long copies in ordinary sums of strings and insertions into vectors once they are
  # inlined (its bugs 105651 and 105329); clang and the sanitizers look at the same code.
  target_compile_options(csipose_flags INTERFACE -Wno-restrict -Wno-array-bounds -Wno-stringop-overflow -Wno-stringop-overread)
endif()

# All presets but dev, and all command lines, compile several files of a target as one, in six tenths of the time or less; so
# the names in anonymous namespaces are unique within a target. GCC takes a file that is included for a header, where a type of an
# anonymous namespace would be a mistake.
set(CSIPOSE_UNITY_FLAGS $<$<CXX_COMPILER_ID:GNU>:-Wno-subobject-linkage>)
if(CMAKE_UNITY_BUILD)
  target_compile_options(csipose_flags INTERFACE ${CSIPOSE_UNITY_FLAGS})
endif()
target_include_directories(csipose_flags INTERFACE ${CMAKE_SOURCE_DIR} ${CMAKE_BINARY_DIR}/generated)
if(CSIPOSE_SANITIZE)
  target_compile_options(csipose_flags INTERFACE -fsanitize=${CSIPOSE_SANITIZE} -fno-sanitize-recover=all -fno-omit-frame-pointer)
  target_link_options(csipose_flags INTERFACE -fsanitize=${CSIPOSE_SANITIZE})
endif()
# Code that must know of the address sanitizer asks by GCC's macro; clang has none.
set(CSIPOSE_ASAN_MACRO "")
if(CSIPOSE_SANITIZE MATCHES address AND CMAKE_CXX_COMPILER_ID STREQUAL Clang)
  set(CSIPOSE_ASAN_MACRO __SANITIZE_ADDRESS__=1)
endif()
if(CSIPOSE_FUZZ)
  # Libraries that fuzz targets name report their branches, so that the fuzzer sees where an input led.
  target_compile_options(csipose_flags INTERFACE $<$<BOOL:$<TARGET_PROPERTY:CSIPOSE_FUZZED>>:-fsanitize=fuzzer-no-link>)
endif()
if(CSIPOSE_SANITIZE MATCHES thread)
  # GCC warns that it does not model fences; we use none across threads.
  target_compile_options(csipose_flags INTERFACE -Wno-tsan)
endif()

# csipose_command_lines(TARGET...): programs whose own files declare options and call on. The option parser's templates take
# longer to compile than all that these files say: not optimised, and a few files at a time, they take about a third.
function(csipose_command_lines)
  foreach(target ${ARGN})
    target_compile_options(${target} PRIVATE -O0 ${CSIPOSE_UNITY_FLAGS})
    set_target_properties(${target} PROPERTIES UNITY_BUILD ON UNITY_BUILD_BATCH_SIZE 5)
  endforeach()
endfunction()

# Tests are GoogleTest programs, each file of them a line of ctest.
#   csipose_tests(PROGRAM FOLDER FILES NAME... LIBRARIES LIB...): NAME_test.cpp .. in one program, each the line FOLDER_NAME_test:
#     compiled together they take less than half the time.
#   csipose_test(NAME FILE [THREADS] LIBRARIES LIB...): a program of its own, for what replaces malloc, runs on lesser
#     processors too, or needs flags. THREADS: more than one thread runs in it, or in a program that it starts; the thread
#     sanitizer's build makes these alone.
# What every test includes is compiled once; test code itself is not worth optimising.
if(CSIPOSE_TESTS)
  add_custom_target(csipose_tests)  # every test that this build runs, with the programs that tests start
  find_package(GTest REQUIRED)
  find_package(fmt REQUIRED)
  file(GENERATE OUTPUT ${CMAKE_BINARY_DIR}/generated/test_headers.cpp CONTENT "")
  add_library(csipose_test_headers OBJECT ${CMAKE_BINARY_DIR}/generated/test_headers.cpp)
  target_compile_options(csipose_test_headers PRIVATE -O0)
  target_link_libraries(csipose_test_headers PRIVATE csipose_flags fmt::fmt GTest::gtest)
  target_precompile_headers(csipose_test_headers PRIVATE <gtest/gtest.h> <fmt/format.h> <filesystem> <fstream> <random>)
endif()
function(csipose_test_program name)
  cmake_parse_arguments(ARG "" "" "FILES;LIBRARIES" ${ARGN})
  add_executable(${name} ${ARG_FILES})
  target_compile_options(${name} PRIVATE -O0)
  target_link_libraries(${name} PRIVATE csipose_flags ${ARG_LIBRARIES} fmt::fmt GTest::gtest GTest::gtest_main)
  target_precompile_headers(${name} REUSE_FROM csipose_test_headers)
  target_compile_definitions(${name} PRIVATE
    CSIPOSE_SHARED_DATA="${CSIPOSE_SHARED_DATA}" CSIPOSE_TEST_DATA="${CMAKE_SOURCE_DIR}/tests/data"
    CSIPOSE_BIN_DIR="${CMAKE_RUNTIME_OUTPUT_DIRECTORY}")
  set_target_properties(${name} PROPERTIES RUNTIME_OUTPUT_DIRECTORY ${CMAKE_BINARY_DIR}/tests)
endfunction()
function(csipose_test name)
  cmake_parse_arguments(ARG "THREADS" "" "LIBRARIES" ${ARGN})
  csipose_test_program(${name} FILES ${ARG_UNPARSED_ARGUMENTS} LIBRARIES ${ARG_LIBRARIES})
  if(CSIPOSE_SANITIZE MATCHES thread AND NOT ARG_THREADS)
    set_target_properties(${name} PROPERTIES EXCLUDE_FROM_ALL ON)
  else()
    add_test(NAME ${name} COMMAND ${name})
    add_dependencies(csipose_tests ${name})
  endif()
endfunction()
function(csipose_tests program folder)
  cmake_parse_arguments(ARG "" "" "FILES;LIBRARIES" ${ARGN})
  list(TRANSFORM ARG_FILES APPEND _test.cpp OUTPUT_VARIABLE files)
  csipose_test_program(${program} FILES ${files} LIBRARIES ${ARG_LIBRARIES})
  if(CSIPOSE_SANITIZE MATCHES thread)
    set_target_properties(${program} PROPERTIES EXCLUDE_FROM_ALL ON)
    return()
  endif()
  add_dependencies(csipose_tests ${program})
  set_property(DIRECTORY APPEND PROPERTY CMAKE_CONFIGURE_DEPENDS ${files})
  foreach(file ${ARG_FILES})
    file(READ ${file}_test.cpp text)
    string(REGEX MATCHALL "\n(TYPED_)?TEST(_F|_P)?\\([A-Za-z0-9_]+" suites "${text}")
    list(TRANSFORM suites REPLACE ".*\\(" "")
    list(REMOVE_DUPLICATES suites)
    if(NOT suites)
      message(FATAL_ERROR "${file}_test.cpp has no test")
    endif()
    list(TRANSFORM suites REPLACE "(.+)" "\\1.*:\\1/*:*/\\1.*" OUTPUT_VARIABLE filter)
    list(JOIN filter ":" filter)
    string(REPLACE "/" "_" line ${folder}_${file}_test)
    add_test(NAME ${line} COMMAND ${program} --gtest_filter=${filter})
  endforeach()
endfunction()

# csipose_fuzz(NAME FILE LIBRARIES LIB...): FILE defines LLVMFuzzerTestOneInput. With CSIPOSE_FUZZ it is a libFuzzer
# program; without, a main() replays the corpus tests/fuzz/corpus/NAME, and ctest runs that in every build.
function(csipose_fuzz name)
  if(CSIPOSE_SANITIZE MATCHES thread)
    return()  # a parser has one thread
  endif()
  cmake_parse_arguments(ARG "" "" "LIBRARIES" ${ARGN})
  set(corpus ${CMAKE_SOURCE_DIR}/tests/fuzz/corpus/${name})
  if(CSIPOSE_FUZZ)
    set_target_properties(${ARG_LIBRARIES} PROPERTIES CSIPOSE_FUZZED ON)
    add_executable(fuzz_${name} ${ARG_UNPARSED_ARGUMENTS})
    target_compile_options(fuzz_${name} PRIVATE -fsanitize=fuzzer)
    target_link_options(fuzz_${name} PRIVATE -fsanitize=fuzzer)
    add_test(NAME fuzz.${name} COMMAND fuzz_${name} -runs=0 ${corpus})
  else()
    add_executable(fuzz_${name} ${ARG_UNPARSED_ARGUMENTS} ${CMAKE_SOURCE_DIR}/tests/fuzz/replay_main.cpp)
    add_test(NAME fuzz.${name} COMMAND fuzz_${name} ${corpus})
  endif()
  add_dependencies(csipose_tests fuzz_${name})
  target_link_libraries(fuzz_${name} PRIVATE csipose_flags ${ARG_LIBRARIES})
  set_target_properties(fuzz_${name} PROPERTIES RUNTIME_OUTPUT_DIRECTORY ${CMAKE_BINARY_DIR}/fuzz)
endfunction()

# generated/version.h: version from project(), commit from git where there is a checkout.
find_package(Git QUIET)
set(CSIPOSE_COMMIT "unknown")
if(GIT_FOUND)
  execute_process(COMMAND ${GIT_EXECUTABLE} -C ${CMAKE_SOURCE_DIR} rev-parse --short=12 HEAD
                  OUTPUT_VARIABLE commit OUTPUT_STRIP_TRAILING_WHITESPACE ERROR_QUIET RESULT_VARIABLE result)
  if(result EQUAL 0)
    set(CSIPOSE_COMMIT ${commit})
  endif()
endif()
configure_file(${CMAKE_SOURCE_DIR}/cmake/version.h.in ${CMAKE_BINARY_DIR}/generated/version.h)
