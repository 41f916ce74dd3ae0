#include "imic3d/app/program.hpp"

#include <fmt/chrono.h>
#include <fmt/format.h>
#include <petscsys.h>
#include <unistd.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <array>
#include <cerrno>
#include <csignal>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <ctime>
#include <filesystem>
#include <functional>
#include <map>
#include <optional>
#include <system_error>
#include <vector>

#include "imic3d/core/interrupt.hpp"
#include "imic3d/core/log.hpp"

namespace imic3d::app {

namespace {

/// PETSc options are written with one dash (-mechanics_ksp_view), the program's own with two. Takes the former, each
/// with its value, out of the arguments.
std::vector<char*> without_petsc_options(int argc, char** argv, std::vector<char*>& petsc) {
  std::vector<char*> own;
  for (int i = 0; i < argc; ++i) {
    const std::string argument = argv[i];
    const bool is_petsc = i > 0 && argument.size() > 2 && argument[0] == '-' && argument[1] != '-';
    (is_petsc ? petsc : own).push_back(argv[i]);
    if (!is_petsc || i + 1 == argc) continue;
    const std::string next = argv[i + 1];
    const bool value = !next.empty() && (next[0] != '-' || (next.size() > 1 && std::isdigit(next[1]) != 0)) &&
                       !next.ends_with(".yaml") && !next.ends_with(".yml") && !next.ends_with(".h5");
    if (value) petsc.push_back(argv[++i]);
  }
  return own;
}

/// The first option of the program that was written with one dash, which PETSc would take; else empty.
std::string with_one_dash(const CLI::App& program, const std::vector<char*>& petsc) {
  for (std::size_t i = 1; i < petsc.size(); ++i) {
    const std::string with_two = std::string("-") + petsc[i];
    for (const CLI::App* command : program.get_subcommands({}))
      if (command->get_option_no_throw(with_two) != nullptr) return with_two;
  }
  return {};
}

/// Says which of PETSc's options nothing has asked for.
void warn_of_unused_options() {
  PetscInt count = 0;
  char **names = nullptr, **values = nullptr;
  if (PetscOptionsLeftGet(nullptr, &count, &names, &values) != 0) return;
  for (PetscInt i = 0; i < count; ++i) spdlog::warn("-{}: nothing has asked for this option", names[i]);
  PetscOptionsLeftRestore(nullptr, &count, &names, &values);
}

/// What mpirun, srun and the like tell the processes that they start.
constexpr const char* launchers[] = {"OMPI_COMM_WORLD_SIZE", "PMIX_RANK", "PMI_RANK", "PMI_FD"};

/// Whether nobody launched this process as one of several.
bool is_alone() {
  return std::none_of(std::begin(launchers), std::end(launchers),
                      [](const char* name) { return std::getenv(name) != nullptr; });
}

/// A folder of its own for what Open MPI writes when a process begins that is alone: in one that all of a user's share
/// another one that ends may take it away meanwhile.
class SessionFolder {
 public:
  SessionFolder() {
    std::error_code error;
    const auto folder = std::filesystem::temp_directory_path(error) / fmt::format("imic3d.{}", getpid());
    if (error || !std::filesystem::create_directory(folder, error)) return;
    folder_ = folder;
    setenv("OMPI_MCA_orte_tmpdir_base", folder_.c_str(), 0);
  }
  ~SessionFolder() {
    std::error_code error;
    if (!folder_.empty()) std::filesystem::remove_all(folder_, error);
  }
  SessionFolder(const SessionFolder&) = delete;
  SessionFolder& operator=(const SessionFolder&) = delete;

 private:
  std::filesystem::path folder_;
};

int said(const Communicator& world, ExitStatus status, const std::string& text) {
  if (world.is_root()) fmt::print(stderr, "{}\n", text);
  note_in_log_file(text);
  return static_cast<int>(status);
}

/// The exit status once everything is printed: not 0 if that failed, unless the reader has seen enough (`| head`).
int printed(const Communicator& world, int status) {
  if (std::fflush(stdout) == 0) return status;
  const bool has_reader = errno != EPIPE;
  if (status == 0 && has_reader)
    status = said(world, ExitStatus::bad_input, fmt::format("standard output: {}", std::strerror(errno)));
  [[maybe_unused]] const auto* nowhere = std::freopen("/dev/null", "w", stdout);  // PETSc writes there at its end
  return status;
}

}  // namespace

int run(int argc, char** argv) {
  static std::array<char, 1 << 20> output;  // of all that a command prints: none is lost with what it prints
  std::setvbuf(stdout, output.data(), _IOFBF, output.size());
  std::optional<SessionFolder> session;
  if (is_alone()) {  // needs no daemon beside it, nor a network, which take Open MPI 0.2 s each to look for
    setenv("OMPI_MCA_ess_singleton_isolated", "1", 0);
    setenv("OMPI_MCA_pml", "ob1", 0);
    session.emplace();
  }
  int provided = 0;
  MPI_Init_thread(&argc, &argv, MPI_THREAD_FUNNELED, &provided);
  session.reset();  // nothing is written there later, and a process that is killed leaves none behind
  const Communicator world;
  int status = 0;
  {
    std::vector<char*> petsc_arguments = {argv[0]};
    std::vector<char*> arguments = without_petsc_options(argc, argv, petsc_arguments);

    CLI::App program("Identifies elasto-plastic parameters from the images and the load record of a mechanical test.",
                     "imic3d");
    program.footer(
        "PETSc options are written with a single dash: -mechanics_ksp_type cg -log_view\n"
        "Exit status: 0 done, 2 bad input, 3 did not converge, 4 stopped (SIGTERM, SIGUSR1, SIGINT, SIGHUP) and can be "
        "resumed: the same command with --resume.");
    CommandOptions options;
    std::function<void()> command;
    const auto add = [&](const std::string& name, const std::string& what, auto function, const std::string& file) {
      CLI::App* sub = program.add_subcommand(name, what);
      sub->add_option(file == "any case" ? "case" : file, options.case_file,
                      file.ends_with("case")  ? "the case file (YAML)"
                      : file == "calibration" ? "the calibration file (YAML)"
                                              : "a results file (HDF5), or its folder")
          ->required(file != "any case");
      sub->add_option("--output", options.output, "folder of the results (default: as the case file says)");
      sub->callback([&command, &world, &options, function] {
        command = [&world, &options, function] { function(world, options); };
      });
      return sub;
    };
    add("check", "reads everything, says everything that is wrong, prints what would be run", check, "case");
    add("simulate", "the equilibrium path under prescribed displacement or force", simulate, "case");
    add("virtual", "a virtual test: simulation, images, load record and the true parameters", virtual_test, "case");
    add("dic", "global finite-element digital image correlation", dic, "case");
    add("identify", "the parameters of the law and their covariance", identify, "case")
        ->add_flag("--resume", options.resume,
                   "goes on from the checkpoint in the folder of the results; from the beginning if there is none");
    add("loop",
        "finds what the identified model leaves unexplained, names it, adds it, and reports the error before and after",
        loop, "case")
        ->add_flag("--resume", options.resume,
                   "goes on from the checkpoint in the folder of the results; from the beginning if there is none");
    CLI::App* reverse =
        add("explain",
            "which effect of the test, if it was left out, carries one set of identified parameters into another",
            explain, "case");
    reverse->add_option("--from", options.from, "result.json of the parameters that are taken for true")->required();
    reverse->add_option("--to", options.to, "result.json of the parameters identified in the test of the case file")
        ->required();
    reverse->add_option("--tolerance", options.tolerance,
                        "relative standard deviation added to those of the sets (default 0.01)");
    add("effects",
        "the effects that the loop knows, with their units (a case file's own, if given), null values and what they "
        "are confused with",
        effects, "any case");
    add("calibrate", "the cameras of a rig from images of a target", calibrate, "calibration");
    add("report", "the self-contained HTML page again, from the results of a run", report, "results");
    program.require_subcommand(0, 1);
    bool show_version = false;
    program.add_flag("--version", show_version, "revision and versions of the libraries");

    try {
      if (const auto option = with_one_dash(program, petsc_arguments); !option.empty())
        throw CLI::ParseError(fmt::format("{}: with two dashes, {}", option.substr(1), option),
                              CLI::ExitCodes::InvalidError);
      program.parse(static_cast<int>(arguments.size()), arguments.data());
      if (show_version) {
        if (world.is_root()) fmt::print("{}", version_text());
      } else if (!command) {
        if (world.is_root()) fmt::print("{}", program.help());
        status = static_cast<int>(ExitStatus::bad_input);
      }
    } catch (const CLI::ParseError& error) {
      if (error.get_exit_code() == 0) {
        if (world.is_root()) program.exit(error);
      } else {
        status = said(world, ExitStatus::bad_input,
                      fmt::format("command line: {}\nimic3d --help lists the commands", error.what()));
      }
      command = nullptr;
    }

    if (command && status == 0) {
      auto petsc_count = static_cast<int>(petsc_arguments.size());
      char** petsc_values = petsc_arguments.data();
      PetscInitialize(&petsc_count, &petsc_values, nullptr, nullptr);
      PetscPushErrorHandler(PetscReturnErrorHandler, nullptr);
      std::signal(SIGPIPE, SIG_IGN);
      start_log(world);
      note_in_log_file(fmt::format("imic3d {} {}, revision {}, {} rank{}, {:%Y-%m-%d}",
                                   program.get_subcommands().front()->get_name(), options.case_file.string(),
                                   revision(), world.size(), world.size() == 1 ? "" : "s",
                                   fmt::localtime(std::time(nullptr))));
      try {
        collectively(world, command);
        warn_of_unused_options();
      } catch (const InputError& error) {
        status = said(world, ExitStatus::bad_input, error.what());
      } catch (const ConvergenceError& error) {
        status = said(world, ExitStatus::not_converged, fmt::format("did not converge: {}", error.what()));
      } catch (const Interrupted& error) {
        status = said(world, ExitStatus::can_be_resumed,
                      fmt::format("stopped by {}; the same command with --resume goes on from here", error.what()));
      } catch (const std::exception& error) {
        status = said(world, ExitStatus::internal_error, fmt::format("internal error: {}", error.what()));
      }
      status = printed(world, status);
      PetscPopErrorHandler();
      PetscFinalize();
    }
    status = printed(world, status);
  }
  MPI_Finalize();
  return status;
}

}  // namespace imic3d::app
